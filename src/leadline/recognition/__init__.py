"""Finding the target in a picture: a neural detector, boxes from a file, the choice of one box, the laser's spot."""
