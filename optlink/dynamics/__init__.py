"""Dynamics of linkages with ideal joints: inertia, loads, reactions, torque, work, motion under a torque."""
