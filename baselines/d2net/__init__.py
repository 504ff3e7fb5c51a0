"""D2-Net, a network that detects and describes keypoints (Dusmanu et al., CVPR 2019)."""
