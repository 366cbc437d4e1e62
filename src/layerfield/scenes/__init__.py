"""Light fields made here."""
