//! Folders with the files of one model.

use super::{TINY, code, folder, json, names, run, said};
use std::process::Output;

#[test]
fn a_folder_has_the_files_of_one_model() {
    let at = folder();
    let generate = |arguments: &[&str]| -> Output {
        let line = [&["generate", "--out", "m", "--backend", "cpu", "--json"], arguments, &TINY[..]].concat();
        run(at.path(), &line)
    };
    let out = at.path().join("m");
    let told = json(&generate(&["--seed", "7", "--outputs", "glb,obj", "--units", "mm"]));
    assert_eq!(told["warnings"], serde_json::json!([]));
    std::fs::write(out.join("notes.txt"), "mine").unwrap();
    // The same model may be written again. Files of formats that are not requested again go.
    let told = json(&generate(&["--seed", "7", "--outputs", "glb", "--units", "mm"]));
    assert_eq!(told["warnings"][0]["code"], "units-unused");
    assert_eq!(names(&out), ["manifest.json", "model.glb", "notes.txt", "report.json", "sections.bin"]);

    let first = std::fs::read(out.join("model.glb")).unwrap();
    let refused = generate(&["--seed", "8", "--outputs", "ply"]);
    assert_eq!((code(&refused), refused.stdout.len()), (2, 0));
    for part in ["error: m: ", "preset pig, seed 7", "--force"] {
        assert!(said(&refused).contains(part), "{part}: {}", said(&refused));
    }
    assert_eq!(std::fs::read(out.join("model.glb")).unwrap(), first);
    let replaced = generate(&["--seed", "8", "--outputs", "ply", "--force"]);
    assert_eq!(json(&replaced)["seed"], 8);
    assert_eq!(names(&out), ["manifest.json", "model.ply", "notes.txt", "report.json", "sections.bin"]);

    // Commands that read the folder notice a file of another model.
    let cut = || run(at.path(), &["cut", "m/model.ply", "--z", "30mm"]);
    let report = || run(at.path(), &["report", "m", "--out", "page.html"]);
    assert_eq!((code(&cut()), code(&report())), (0, 0));
    let ply = std::fs::read(out.join("model.ply")).unwrap();
    std::fs::write(out.join("model.ply"), [&ply[..], b"\n"].concat()).unwrap();
    let mixed = cut();
    assert_eq!(code(&mixed), 1);
    assert!(said(&mixed).contains("m/model.ply differs from manifest.json"), "{}", said(&mixed));
    std::fs::write(out.join("model.ply"), ply).unwrap();
    let mut sections = std::fs::read(out.join("sections.bin")).unwrap();
    *sections.last_mut().unwrap() ^= 1;
    std::fs::write(out.join("sections.bin"), sections).unwrap();
    let mixed = report();
    assert_eq!(code(&mixed), 1);
    assert!(said(&mixed).contains("m/sections.bin differs from manifest.json"), "{}", said(&mixed));

    std::fs::remove_file(out.join("manifest.json")).unwrap();
    let refused = generate(&["--seed", "8"]);
    assert!(code(&refused) == 2 && said(&refused).contains("without a manifest.json"), "{}", said(&refused));
}
