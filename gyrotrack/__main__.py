"""Entry point of ``python -m gyrotrack``."""

from gyrotrack.apps.cli._start import main

if __name__ == "__main__":
    main()
