"""Joint clearance: contact forces, equations of motion, integration, compensation by control."""
