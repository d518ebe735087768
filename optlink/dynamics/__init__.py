"""Dynamics of linkages with ideal joints: inertia, loads, reactions, torque, work, forward dynamics."""
