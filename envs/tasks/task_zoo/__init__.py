"""Tasks after the robosuite task zoo, commit 74eab7f (MIT): HammerPlace, ToolUse, Kitchen, MultitaskKitchen.

Sizes, places and rules are those of its Python and XML files; textures are not. Its world's origin is 0.9 m
below ours, which is in the top of the table.
"""
