"""What a machine does over its cycle: quantities, and objective and limits in them."""
