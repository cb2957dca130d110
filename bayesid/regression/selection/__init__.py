"""What a log wants beyond a model: effects of the catalogue as columns, their evidence, and the selection of some."""
