"""Videos of a tank: tracks of thrown bars and of built robots. Needs OpenCV: make setup EXTRAS=vision."""

from pipeline.errors import PuddleError


def require_vision() -> None:
    """Check that OpenCV can be imported and has what finds tags. Raises PuddleError otherwise."""
    try:
        from cv2.aruco import ArucoDetector  # noqa: F401
    except ImportError as error:
        raise PuddleError(
            f"OpenCV is needed to find and print tags, expected one wheel of 4.9 or later, got: {error}. Run `make "
            f"setup EXTRAS=vision` in the checkout; without a checkout, `pip install 'puddle[vision]'`."
        ) from None
