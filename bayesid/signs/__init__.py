"""From |effort| to signs."""
