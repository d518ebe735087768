"""Programs of their own that check results of optlink; nothing in them is imported from the package."""
