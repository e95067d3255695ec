"""What the scripts that compare the `nearfield` command with other libraries share."""

import subprocess
import sys


def run(command, *arguments):
    """What the command prints; ends the script with its message where it fails."""
    done = subprocess.run([command, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{command} {' '.join(map(str, arguments))} ended with {done.returncode}: {done.stderr.strip()}")
    return done.stdout
