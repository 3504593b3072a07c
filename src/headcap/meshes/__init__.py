"""Triangle meshes: topology, normals, Laplacians, subdivision, UV maps, deformation gradients, solvers, rasteriser."""
