"""The command line: ``modiolus``."""
