"""Selection of effects: columns of the catalogue, their evidence, and the effects that a log shows."""
