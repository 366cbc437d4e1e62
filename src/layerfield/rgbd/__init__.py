"""Light fields of a picture and its depth map: approximate, as what is hidden is made up."""
