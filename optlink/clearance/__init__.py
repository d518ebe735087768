"""What play in the joints does: contact forces, mechanisms with gaps, the control that makes up for them."""
