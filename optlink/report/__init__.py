"""Show me: tables for the terminal, pictures, files."""
