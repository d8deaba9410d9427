"""An episode in the Rerun viewer: its scene in 3D over time, camera images and randomization draws."""
