"""Small modules that any package may use: errors, units, names, text, files."""
