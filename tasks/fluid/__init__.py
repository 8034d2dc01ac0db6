"""Water in two dimensions: incompressible, with a free surface and a floor, coupled both ways to rigid links."""

from tasks.fluid.flume import Flume
