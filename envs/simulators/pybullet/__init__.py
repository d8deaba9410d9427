"""PyBullet: rigid bodies and articulations by Bullet, images by its software rasterizer."""
