"""The only place that draws: pages and PNG files."""
