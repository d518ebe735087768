"""Sections of a problem file about the machine: bodies, joints, loads, control, balancing."""
