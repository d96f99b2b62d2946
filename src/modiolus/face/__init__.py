"""The head: template, tissue, muscles, deep structures, expressions, and the shipped data."""
