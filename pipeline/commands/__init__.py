"""The subcommands; each composes what it needs, importing late."""
