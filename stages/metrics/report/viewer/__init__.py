"""The report's viewer: the object in 3D, or a light stage's maps under a light that the pointer moves; plain WebGL2.

Python packs what is shown (`model_scene`, `rig_scene`) and joins the scripts and shaders of this folder into the page (`page`).
"""
