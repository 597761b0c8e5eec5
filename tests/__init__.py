"""The tests, in the rooms of jaxstab; ``tests.truth`` has what they are compared with."""
