"""PyBullet: rigid bodies and articulations by Bullet, pictures by its software rasterizer."""
