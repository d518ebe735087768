"""Problem files: the TOML sections as pydantic models, and the problems that they state."""
