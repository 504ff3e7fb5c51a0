"""Visual depth and dense clouds: multi-view PatchMatch on the photographs of a map."""
