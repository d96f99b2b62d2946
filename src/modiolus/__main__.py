"""Run the command line as ``python -m modiolus``."""

from .cli import main

if __name__ == "__main__":
    main()
