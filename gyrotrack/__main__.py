"""``python -m gyrotrack`` is `gyrotrack`."""

from gyrotrack.apps.cli._app import main

if __name__ == "__main__":
    main()
