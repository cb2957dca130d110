"""What a controller recorded: reading, filtering, segments of constant sign."""
