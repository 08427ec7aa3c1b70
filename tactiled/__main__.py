"""python -m tactiled."""

from tactiled.cli import main

if __name__ == "__main__":
    main()
