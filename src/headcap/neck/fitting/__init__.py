"""From meshes to coefficients: pose, expression, larynx and speech of anybody, in any order."""
