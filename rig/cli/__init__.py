"""The ``rig`` command: entry, exit statuses, crash reports, subcommands."""
