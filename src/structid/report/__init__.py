"""The only place that draws: pages and PNG files."""

from structid.report.identification import write_report

__all__ = ["write_report"]
