"""Imports a model into Blender, renders it and saves the scene.

Usage: blender --background --python blender_import.py -- DIR [OUT]
   or, after `pip install bpy`: python blender_import.py DIR [OUT]

Reads model.glb and lumen.glb (metres), writes OUT/blender.blend and OUT/blender.png. The tissue is
cut open, and each patch has its own material. One millimetre becomes one Blender unit, because
Blender's views clip much smaller objects. The glTF importer turns the axes: the tube lies along z
in the file and along -y in Blender.
"""

import math
import os
import sys

import bpy
from mathutils import Matrix, Vector

# Colour (red, green, blue) and roughness of each patch.
LOOKS = {"inner_wall": ((0.75, 0.25, 0.25), 0.4), "outer_wall": ((0.80, 0.50, 0.45), 0.6),
         "cap_isthmus": ((0.80, 0.42, 0.38), 0.6), "cap_ampulla": ((0.80, 0.42, 0.38), 0.6),
         "wall": ((0.90, 0.75, 0.40), 0.3), "inlet": ((0.15, 0.35, 0.80), 0.3), "outlet": ((0.80, 0.15, 0.10), 0.3)}


def material(name):
    """Creates the material of a patch."""
    colour, rough = LOOKS[name]
    made = bpy.data.materials.new(f"oviduct {name}")
    if not made.use_nodes:
        made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1)
    shader.inputs["Roughness"].default_value = rough
    made.diffuse_color = (*colour, 1)
    return made


def load(path):
    """Imports a body as one object with a material per patch and one unit per millimetre."""
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.import_scene.gltf(filepath=path)
    imported = list(bpy.context.selected_objects)
    parts = [part for part in imported if part.type == "MESH"]
    for part in parts:
        name = part.name.split(".")[0]
        part.data.materials.clear()
        part.data.materials.append(material(name))
        part.data.transform(Matrix.Scale(1000, 4) @ part.matrix_world)
        part.parent = None
        part.matrix_world = Matrix.Identity(4)
    for other in imported:
        if other.type != "MESH":
            bpy.data.objects.remove(other)
    print(f"{os.path.basename(path)}: " + ", ".join(f"{part.name} {len(part.data.polygons)} triangles" for part in parts))
    bpy.ops.object.select_all(action="DESELECT")
    for part in parts:
        part.select_set(True)
    bpy.context.view_layer.objects.active = parts[0]
    bpy.ops.object.join()
    body = bpy.context.view_layer.objects.active
    body.name = os.path.basename(path).split(".")[0]
    # Joins the patches: each has its own copies of the vertices along its border.
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.remove_doubles(threshold=0)
    bpy.ops.object.mode_set(mode="OBJECT")
    return body


def halve(body):
    """Removes the half of a body at positive x and closes the cut."""
    bpy.ops.object.select_all(action="DESELECT")
    body.select_set(True)
    bpy.context.view_layer.objects.active = body
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.bisect(plane_co=(0, 0, 0), plane_no=(1, 0, 0), clear_outer=True, use_fill=True)
    bpy.ops.mesh.customdata_custom_splitnormals_clear()
    bpy.ops.object.mode_set(mode="OBJECT")
    body.data.set_sharp_from_angle(angle=math.radians(40))
    for face in body.data.polygons:
        if face.normal.x > 0.999:
            face.use_smooth = False


def main():
    words = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    folder, out = words[0], words[1] if len(words) > 1 else words[0]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    tissue, lumen = (load(os.path.join(folder, name)) for name in ("model.glb", "lumen.glb"))
    halve(tissue)

    corners = [Vector(corner) for corner in tissue.bound_box]
    centre = sum(corners, Vector()) / 8
    size = max((corner - centre).length for corner in corners)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = centre + Vector((2.6, 1.6, 1.2)).normalized() * 3.6 * size
    camera.rotation_euler = (centre - camera.location).to_track_quat("-Z", "Y").to_euler()
    camera.data.clip_start, camera.data.clip_end = 0.001 * size, 100 * size
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 2, (math.radians(30), math.radians(35), 0)
    scene = bpy.context.scene
    scene.collection.objects.link(camera)
    scene.collection.objects.link(sun)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("world")
    if not scene.world.use_nodes:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5

    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.cycles.device = "CPU"
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = 1000, 700
    scene.render.filepath = os.path.abspath(os.path.join(out, "blender.png"))
    bpy.ops.render.render(write_still=True)
    bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(os.path.join(out, "blender.blend")))
    for body in (tissue, lumen):
        print(f"{body.name}: {len(body.data.vertices)} vertices, size "
              f"{' x '.join(f'{extent:.4g}' for extent in body.dimensions)} mm, materials "
              f"{', '.join(slot.material.name for slot in body.material_slots)}")


if __name__ == "__main__":
    main()
