"""Videos of a tank: tracks of thrown bars and of built robots. Needs OpenCV: make setup EXTRAS=vision."""

import contextlib
import io
from importlib.util import find_spec

from pipeline.errors import PuddleError


def require_vision() -> None:
    """Check that OpenCV is installed and whole. Raises PuddleError otherwise."""
    if find_spec("cv2") is None:
        raise PuddleError(
            "opencv-python-headless not installed, but needed to find and print tags. Run `make setup EXTRAS=vision` "
            "in the checkout; without a checkout, `pip install 'puddle[vision]'`."
        )
    problem = ""
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # NumPy prints pages about a wheel that was built for NumPy 1
            import cv2
        if not hasattr(getattr(cv2, "aruco", None), "ArucoDetector"):
            problem = f"OpenCV {getattr(cv2, '__version__', 'of an unknown version')} has no cv2.aruco.ArucoDetector"
    except ImportError as error:
        problem = f"OpenCV cannot be imported ({error})"
    if problem:
        raise PuddleError(
            f"{problem}, expected one wheel of 4.9 or later. Run `pip uninstall opencv-python opencv-contrib-python "
            f"opencv-python-headless opencv-contrib-python-headless`, then `pip install 'opencv-python-headless>=4.9'`."
        )
