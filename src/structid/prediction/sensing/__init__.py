"""Motion and forces during a record of other places: a Kalman smoother of modes, and its verdict on the model."""
