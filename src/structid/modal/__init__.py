"""Modes from records: one method a file, Record to ModalRecord."""
