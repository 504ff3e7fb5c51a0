"""Featuremetric alignment: the pose at which an image's features equal those of the map's points.

For every level, coarse to fine, ``aligner`` minimises over the pose

    sum over points  w * rho(|F(project(pose, X)) - f|^2)

with F the query's feature map, f the point's feature in the reference images, w the product of the
confidences of both and rho a robust cost (Sarlin et al., Back to the Feature, CVPR 2021; section
3.2).
"""
