"""Images to measurements: matching, shape, outline, beam."""
