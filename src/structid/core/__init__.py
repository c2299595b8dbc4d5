"""Tools that know nothing of structures: arrays, degrees of freedom by name, units, errors, display, JSON types."""
