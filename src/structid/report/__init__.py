"""The only place that draws: a page and PNG figures of an identification."""

from structid.report.html import write_report

__all__ = ["write_report"]
