"""What each command does: read, call the Python interface, write and show. A module a command, with its `run`."""
