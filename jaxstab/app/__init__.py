"""What people meet: scenes, commands, pictures, the explorer. It imports the core and the lab."""
