"""New studies from a few numbers: one template a kind of structure, a line each in `TEMPLATES`."""

from structid.study.templates.frames import (
    BeamTemplate,
    BridgeTemplate,
    FrameTemplate,
    OwnMatricesTemplate,
    PlateTemplate,
    ShearBuildingTemplate,
)
from structid.study.templates.mesh import MeshTemplate
from structid.study.templates.template import (
    Template,
    TemplateQuestion,
    asked_of,
    asked_value,
    study_file,
    template_with,
    write_study,
)

#: Every template by the name that `structid init` takes.
TEMPLATES: dict[str, type[Template]] = {
    "beam": BeamTemplate,
    "bridge": BridgeTemplate,
    "frame": FrameTemplate,
    "shear-building": ShearBuildingTemplate,
    "plate": PlateTemplate,
    "mesh": MeshTemplate,
    "own-matrices": OwnMatricesTemplate,
}

__all__ = [
    "TEMPLATES",
    "MeshTemplate",
    "Template",
    "TemplateQuestion",
    "asked_of",
    "asked_value",
    "study_file",
    "template_with",
    "write_study",
]
