"""Vision: from the corners of tags in a picture to the positions and angles of bars, with their uncertainty."""
