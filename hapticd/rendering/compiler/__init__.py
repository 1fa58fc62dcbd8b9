"""From scene and materials to the table that the tick reads: flat C records in the units of a tick."""
