"""``python -m gyrotrack`` is `gyrotrack`."""

from gyrotrack.cli.app import main

if __name__ == "__main__":
    main()
