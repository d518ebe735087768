"""How a design is found: exchangeable back ends, starts, conflicts; and the Solution that proves itself."""
