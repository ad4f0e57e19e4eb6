"""Draws the lumen as a cast in the opened tissue of a model, without a screen (VTK).

Usage: view.py DIR [--out DIR] [--stretch F]

Reads model.vtp and lumen.vtp, writes view.png. `--stretch 0.1` draws a long tube at a tenth of its
length. For the same picture in ParaView, open both files, colour by `patch`, apply the filter Clip
to model.vtp with the normal x, and scale z in the properties of both (Transforming, Scale).
"""

import os

import vtk

from bodies import arguments, read_polydata

TISSUE, LUMEN, INLET, OUTLET = (0.87, 0.58, 0.55), (0.95, 0.83, 0.55), (0.25, 0.45, 0.80), (0.80, 0.30, 0.25)


def table(colours):
    """Returns a lookup table with one colour per patch."""
    found = vtk.vtkLookupTable()
    found.SetNumberOfTableValues(len(colours))
    found.SetTableRange(0, len(colours) - 1)
    for k, colour in enumerate(colours):
        found.SetTableValue(k, *colour, 1)
    return found


def actor(source, colours, stretch):
    """Returns an actor that shows a surface with one colour per patch."""
    normals = vtk.vtkPolyDataNormals()
    normals.SetInputConnection(source)
    normals.SetFeatureAngle(60)
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputConnection(normals.GetOutputPort())
    mapper.SetScalarModeToUseCellFieldData()
    mapper.SelectColorArray("patch")
    mapper.SetLookupTable(table(colours))
    mapper.UseLookupTableScalarRangeOn()
    made = vtk.vtkActor()
    made.SetMapper(mapper)
    made.GetProperty().SetAmbient(0.3)
    made.SetScale(1, 1, stretch)
    return made


def main():
    options = arguments(__doc__, ("--stretch", {"type": float, "default": 1.0, "help": "scale of the drawing along the tube"}))
    tissue, names = read_polydata(os.path.join(options.folder, "model.vtp"))
    lumen, ends = read_polydata(os.path.join(options.folder, "lumen.vtp"))
    x0, x1, _, _, z0, z1 = tissue.GetBounds()

    # Half of the tissue: the cut through a closed surface is filled.
    plane = vtk.vtkPlane()
    plane.SetOrigin((x0 + x1) / 2, 0, 0)
    plane.SetNormal(-1, 0, 0)
    planes = vtk.vtkPlaneCollection()
    planes.AddItem(plane)
    half = vtk.vtkClipClosedSurface()
    half.SetInputData(tissue)
    half.SetClippingPlanes(planes)
    half.SetPassPointData(False)
    half.SetScalarModeToNone()
    whole = vtk.vtkTrivialProducer()
    whole.SetOutput(lumen)

    scene = vtk.vtkRenderer()
    scene.SetBackground(1, 1, 1)
    cut = vtk.vtkPolyDataMapper()
    cut.SetInputConnection(half.GetOutputPort())
    cut.ScalarVisibilityOff()
    shown = vtk.vtkActor()
    shown.SetMapper(cut)
    shown.GetProperty().SetColor(*TISSUE)
    shown.GetProperty().SetAmbient(0.3)
    shown.SetScale(1, 1, options.stretch)
    scene.AddActor(shown)
    colours = {"wall": LUMEN, "inlet": INLET, "outlet": OUTLET}
    scene.AddActor(actor(whole.GetOutputPort(), [colours[name] for name in ends["patch_names"]], options.stretch))

    camera = scene.GetActiveCamera()
    middle = options.stretch * (z0 + z1) / 2
    camera.SetFocalPoint((x0 + x1) / 2, 0, middle)
    camera.SetPosition((x0 + x1) / 2 + 3, 1.5, middle + 2)
    camera.SetViewUp(0, 1, 0)
    scene.ResetCamera()
    camera.Zoom(1.3)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetSize(1200, 800)
    window.SetMultiSamples(8)
    window.AddRenderer(scene)
    window.Render()
    picture = vtk.vtkWindowToImageFilter()
    picture.SetInput(window)
    picture.ReadFrontBufferOff()
    writer = vtk.vtkPNGWriter()
    writer.SetFileName(os.path.join(options.out, "view.png"))
    writer.SetInputConnection(picture.GetOutputPort())
    writer.Write()
    print(f"{writer.GetFileName()}: tissue with the patches {', '.join(names['patch_names'])}; "
          f"lumen with {', '.join(ends['patch_names'])}; drawn by {window.GetClassName()}")


if __name__ == "__main__":
    main()
