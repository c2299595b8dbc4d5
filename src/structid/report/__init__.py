"""The only place that draws: a page and PNG figures of an identification."""

from structid.report.identification.page import write_report

__all__ = ["write_report"]
