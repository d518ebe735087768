"""Result files, read strictly."""
