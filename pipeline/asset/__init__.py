"""A surface with textures, from pictures of it to files that other programs open.

Two stages make assets from different evidence (a trained model's G-buffers, a light stage's maps), so what they share is here:
the atlas, the blending of views in it, and the files. It knows no stage: views are handed in as channels with cameras.
"""
