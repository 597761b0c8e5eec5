"""What an atlas file is: schema, specification, footer, digest."""
