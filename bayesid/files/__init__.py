"""Files: text from outside within bounds, and results that are written whole or not at all."""
