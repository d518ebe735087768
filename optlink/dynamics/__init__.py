"""What the motion costs: inertia, loads, reactions, torque, work, motion under a torque."""
