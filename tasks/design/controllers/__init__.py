"""Controllers: what turns a robot's joints. Each is one file, which registers it; see controller.py."""

from tasks.design.controllers.controller import (
    CONTROLLERS,
    OPEN_LOOP,
    Controller,
    Joint,
    controller_named,
    gain,
    register_controller,
)
from tasks.design.gene import Gene
from tasks.discovery import import_extensions

import_extensions(__name__, __path__)
