"""D2-Net: one network describes and detects (Dusmanu et al., CVPR 2019)."""
