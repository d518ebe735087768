"""Problem files: the TOML sections as pydantic models, and the problems they define."""
