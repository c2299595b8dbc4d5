"""A search whose model comes from a solver: led near, confirmed by runs, and moved about its answer."""
