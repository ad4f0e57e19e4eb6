//! `oviduct compare --checklist`: agreement of models with the anatomical checklist.

use super::{code, folder, json, run, said};
use serde_json::Value;

#[test]
fn compare_counts_the_models_that_agree_with_each_statement() {
    let at = folder();
    let arguments = ["compare", "--preset", "utero-tubal-junction", "--seeds", "1..2", "--checklist"];
    let output = run(at.path(), &arguments);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    let found = json(&run(at.path(), &[&arguments[..], &["--json"]].concat()));
    let tally = &found[0]["checklist"];
    let models = found[0]["models"].as_array().expect("models");
    assert_eq!((found[0]["preset"].as_str(), models.len()), (Some("utero-tubal-junction"), 2));
    assert_eq!(tally["models"], 2);

    // The table has the counts of the JSON, and these are those of the models.
    let count = |name: &str| tally[name].as_u64().expect("a number");
    let (holds, fails, missing) = (count("holds"), count("fails"), count("not_measurable"));
    let line = format!("- `utero-tubal-junction`: {holds} of {} measurable statements hold", holds + fails);
    assert!(table.contains(&line), "{table}");
    let statements = tally["statements"].as_array().expect("statements");
    assert_eq!(statements.len() as u64, holds + fails + missing);
    for (k, statement) in statements.iter().enumerate() {
        let verdict = |model: &Value| model["checklist"]["statements"][k]["verdict"].as_str().map(str::to_owned);
        let own = models.iter().filter(|model| verdict(model).as_deref() == Some("holds")).count();
        assert_eq!(statement["holds_in"], own, "{statement}");
        let row = format!("| {} | **{}** |", statement["number"], statement["statement"].as_str().expect("text"));
        assert!(table.contains(&row), "{row}\n{table}");
    }
    let numbers: Vec<u64> = statements.iter().filter_map(|one| one["number"].as_u64()).collect();
    assert_eq!(numbers, [2, 25], "those about the utero-tubal junction");
}
