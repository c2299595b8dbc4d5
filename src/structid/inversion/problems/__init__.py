"""Problems made of problems: several as one, with other data, with a parameter held."""
