"""Videos of a tank: tracks of thrown bars and of built robots. Needs OpenCV: make setup EXTRAS=vision."""

from importlib.util import find_spec

from pipeline.errors import PuddleError


def require_vision() -> None:
    """Check that OpenCV is installed. Raises PuddleError otherwise."""
    if find_spec("cv2") is None:
        raise PuddleError(
            "opencv-python-headless not installed, but needed to find and print tags. Run `make setup EXTRAS=vision` "
            "in the checkout; without a checkout, `pip install 'puddle[vision]'`."
        )
