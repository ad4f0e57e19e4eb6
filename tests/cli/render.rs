//! `oviduct render`: pictures of files.

use super::{TINY, code, folder, json, names, run, said};
use std::path::Path;
use tiny_skia::Pixmap;

/// Grows a model into `at/model`.
fn grow(at: &Path) {
    let generate = [
        &["generate", "--seed", "3", "--gpu", "off", "--json", "--set", "lean.strength_um=0", "--out", "model"],
        &TINY[..],
    ]
    .concat();
    json(&run(at, &generate));
}

fn picture(path: &Path) -> Pixmap {
    Pixmap::load_png(path).expect("a picture")
}

/// Fraction of the non-empty pixels in which any channel differs by more than `tolerance`.
fn difference(a: &Pixmap, b: &Pixmap, tolerance: u8) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let differ = a.data().chunks(4).zip(b.data().chunks(4));
    let differ = differ.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > tolerance)).count();
    differ as f64 / a.pixels().iter().filter(|p| p.alpha() > 0).count() as f64
}

#[test]
fn a_surface_and_its_sections_give_the_same_pictures() {
    let at = folder();
    grow(at.path());
    let mut opened = Vec::new();
    for view in ["whole", "opened", "isthmus", "ampulla"] {
        for (file, out) in [("model/model.glb", "glb.png"), ("model/sections.bin", "bin.png")] {
            let output = run(at.path(), &["render", file, "--view", view, "--size", "200", "--out", out]);
            assert_eq!(code(&output), 0, "{}", said(&output));
            assert_eq!(String::from_utf8_lossy(&output.stdout), format!("{file}: ./{out}\n"));
        }
        let [glb, bin] = ["glb.png", "bin.png"].map(|name| picture(&at.path().join(name)));
        assert_eq!(glb.width(), 200);
        let differ = difference(&glb, &bin, 24);
        assert!(differ < 0.05, "{view}: {differ}");
        opened.push(glb);
    }
    assert!(difference(&opened[0], &opened[1], 24) > 0.1, "the view is not that of the whole tube");
}

#[test]
fn any_direction_and_cut_can_be_drawn() {
    let at = folder();
    grow(at.path());
    let draw = |options: &[&str]| {
        let output =
            run(at.path(), &[&["render", "model/model.glb", "--size", "120", "--out", "p.png"], options].concat());
        assert_eq!(code(&output), 0, "{}", said(&output));
        picture(&at.path().join("p.png"))
    };
    let filled = |picture: &Pixmap| picture.pixels().iter().filter(|p| p.alpha() > 0).count();
    let whole = draw(&["--view", "whole"]);
    // Seen along its axis, the round end of the tube fills most of the height.
    let end_on = draw(&["--view", "whole", "--azimuth", "0", "--elevation", "0"]);
    assert!(difference(&whole, &end_on, 24) > 0.3);
    let half = draw(&["--view", "whole", "--azimuth", "0", "--elevation", "0", "--cut", "x=0"]);
    let left = (0..80).filter(|&y| half.pixel(70, y).expect("inside").alpha() > 0).count();
    assert!(left > 0 && filled(&half) < filled(&end_on), "{left}");
    // A plane that cuts nothing or everything is probably in the wrong place or unit.
    for (cut, told) in [
        ("z=-1m", "the plane z=-1m cuts away everything; the model reaches from 0 to 60mm along z"),
        ("-z=-1m", "the plane z=-1m cuts away nothing; the model reaches from 0 to 60mm along z"),
        ("z=60mm", "the plane z=60mm cuts away nothing"),
        ("-z=42m", "the plane z=42m cuts away everything"),
        ("z=30mm;0,1,1=42m", "the plane 0.000,0.707,0.707=42m cuts away nothing"),
    ] {
        let output = run(at.path(), &["render", "model/model.glb", "--cut", cut, "--out", "none.png"]);
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(code(&output) == 1 && printed.contains(told), "{cut}: {printed}");
    }
    assert!(!at.path().join("none.png").exists());
}

#[test]
fn cut_faces_are_stained_unless_the_picture_is_plain() {
    let at = folder();
    grow(at.path());
    let draw = |options: &[&str]| {
        let view = ["render", "model/sections.bin", "--view", "ampulla", "--size", "240", "--out", "p.png"];
        let output = run(at.path(), &[&view, options].concat());
        assert_eq!(code(&output), 0, "{}", said(&output));
        picture(&at.path().join("p.png"))
    };
    let (stained, plain, human) = (draw(&[]), draw(&["--plain"]), draw(&["--preset", "human"]));
    assert!(difference(&stained, &plain, 24) > 0.1, "{}", difference(&stained, &plain, 24));
    // Other layers, and the texture of another seed.
    assert!(difference(&stained, &human, 8) > 0.02, "{}", difference(&stained, &human, 8));
    assert_eq!(draw(&[]).data(), stained.data());
}

#[test]
fn files_that_cannot_be_drawn_are_named() {
    let at = folder();
    grow(at.path());
    std::fs::write(at.path().join("broken.stl"), "solid nothing\n").expect("written");
    std::fs::copy(at.path().join("model/model.glb"), at.path().join("copy.glb")).expect("copied");
    let output = run(at.path(), &["render", "copy.glb", "broken.stl", "missing.obj", "--size", "64", "--out", "a/b"]);
    assert_eq!(code(&output), 1);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(lines[0], "copy.glb: a/b/copy.png");
    assert!(lines[1].starts_with("broken.stl: cannot be drawn: "), "{printed}");
    assert!(lines[2].starts_with("missing.obj: cannot be drawn: "), "{printed}");
    assert_eq!(names(&at.path().join("a/b")), ["copy.png"]);
    for wrong in [
        &["render"][..],
        &["render", "copy.glb", "--view", "inside"],
        &["render", "copy.glb", "--size", "31"],
        &["render", "copy.glb", "--cut", "z=12"],
        &["render", "copy.glb", "--elevation", "90"],
        &["render", "copy.glb", "--preset", "cat"],
        &["render", "copy.glb", "model/model.glb", "--out", "one.png"],
        &["render", "copy.glb", "model/copy.obj"],
    ] {
        let output = run(at.path(), wrong);
        assert_eq!((code(&output), output.stdout.len()), (2, 0), "{wrong:?}: {}", said(&output));
    }
}
