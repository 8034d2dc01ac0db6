"""Forms of networks. Each is one file in this folder, which registers it."""

from tasks.discovery import import_extensions
from tasks.residual.forms.form import (
    FORMS,
    Form,
    Targets,
    form_here,
    form_named,
    kicks_unseen,
    observe,
    register_form,
    symmetric_copies,
    velocity_changes,
)

import_extensions(__name__, __path__)
