"""What an atlas may hold: one module for each product, and the table of them."""
