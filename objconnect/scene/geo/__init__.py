"""Maps and positions in the coordinate systems of surveyors (extra ``[geo]``)."""
