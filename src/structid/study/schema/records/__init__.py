"""Sections that say what was measured: FRFs, histories, modes, their sensors and set-ups."""
