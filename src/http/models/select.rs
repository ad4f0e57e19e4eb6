//! Query parameters: filters of models, pages and flags.

use super::request::MAX_LABELS;
use crate::http::access::Caller;
use crate::http::wire::extract::{Parameters, parse_id};
use crate::http::wire::faults::{Faults, RequestFault};
use crate::jobs::{BatchId, JobId, ListFilter, Status};
use jiff::Timestamp;
use utoipa::IntoParams;
use uuid::Uuid;

/// The parameters in [`CONDITIONS`], for the description of routes; [`read`] reads them.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "only described")]
pub(in crate::http) struct Conditions {
    /// Only models of this status
    status: Option<Status>,
    /// Only models of this preset
    #[param(pattern = "^[^\\u0000]*$")]
    preset: Option<String>,
    /// Only models with this label, `key:value`. May be repeated; models must have all labels
    #[param(max_items = 16, pattern = "^[^:\\u0000]+:[^\\u0000]*$")]
    label: Option<Vec<String>>,
    /// Only models of this batch
    batch: Option<Uuid>,
    /// Only models of this owner; without the scope `admin`, only the caller's own name is allowed
    #[param(pattern = "^[^\\u0000]*$")]
    owner: Option<String>,
    /// Only models accepted at this time (RFC 3339) or later
    #[param(format = DateTime)]
    created_after: Option<String>,
    /// Only models accepted before this time (RFC 3339)
    #[param(format = DateTime)]
    created_before: Option<String>,
}

/// Names of the parameters that filter lists of models, and requests to cancel or delete many
/// models.
pub(in crate::http) const CONDITIONS: [&str; 7] =
    ["status", "preset", "label", "batch", "owner", "created_after", "created_before"];

/// Maximum number of ids in a request.
const MAX_IDS: usize = 100;
/// Default number of members of a page.
const DEFAULT_PAGE: u32 = 20;
/// Maximum number of members of a page.
const MAX_PAGE: u32 = 100;

/// The filter that the parameters describe, limited to models that the caller may see. Ignores
/// parameters with other names; [`Parameters::faults`] checks which ones a route has.
pub(in crate::http) fn read(parameters: &Parameters, caller: &Caller, faults: &mut Faults) -> ListFilter {
    let mut filter = ListFilter { owner: caller.only().map(str::to_owned), ..ListFilter::default() };
    for (name, value) in &parameters.0 {
        if let Err(detail) = add(&mut filter, name, value, caller) {
            faults.push(RequestFault::parameter(name, detail));
        }
    }
    filter
}

/// Adds the condition of one parameter to the filter.
///
/// # Errors
/// Returns the detail of the fault.
fn add(filter: &mut ListFilter, name: &str, value: &str, caller: &Caller) -> Result<(), String> {
    match name {
        // No record contains NUL, and PostgreSQL refuses it in a query.
        "preset" | "label" | "owner" if value.contains('\0') => return Err("must not contain NUL".into()),
        "status" => {
            let status = serde_json::from_value::<Status>(value.into());
            filter.status = Some(status.map_err(|_| "must be queued, running, succeeded, failed or cancelled")?);
        }
        "preset" => filter.preset = Some(value.to_owned()),
        "label" if filter.labels.len() == MAX_LABELS => return Err(format!("may be given at most {MAX_LABELS} times")),
        "label" => {
            let (key, value) = value.split_once(':').ok_or("must be a key and a value, separated by a colon")?;
            filter.labels.push((key.to_owned(), value.to_owned()));
        }
        "batch" => {
            let JobId(id) = parse_id(value).ok_or("must be the id of a batch")?;
            filter.batch = Some(BatchId(id));
        }
        "ids" => filter.ids = ids(value)?,
        "owner" if !caller.sees(Some(value)) => {
            return Err("must be your own name; only a key that allows admin sees the models of others".into());
        }
        "owner" => filter.owner = Some(value.to_owned()),
        "created_after" => filter.created_after = Some(time(value)?),
        "created_before" => filter.created_before = Some(time(value)?),
        _ => {}
    }
    Ok(())
}

/// The requested page: its number of members, and the id before which it starts.
pub(in crate::http) fn page(parameters: &Parameters, faults: &mut Faults) -> (u32, Option<JobId>) {
    let limit = parameters.get("limit").map_or(Some(DEFAULT_PAGE), |value| value.parse().ok());
    let limit = limit.filter(|limit| (1..=MAX_PAGE).contains(limit)).unwrap_or_else(|| {
        faults.push(RequestFault::parameter("limit", format!("must be an integer from 1 to {MAX_PAGE}")));
        DEFAULT_PAGE
    });
    let before = parameters.get("cursor").and_then(|value| {
        let id = parse_id(value);
        if id.is_none() {
            faults.push(RequestFault::parameter("cursor", "must be the `next` of a page"));
        }
        id
    });
    (limit, before)
}

/// Reads the parameter `name`, `true` or `false`; false if it is absent.
pub(in crate::http) fn flag(parameters: &Parameters, name: &str, faults: &mut Faults) -> bool {
    match parameters.get(name) {
        Some("true") => true,
        None | Some("false") => false,
        Some(_) => {
            faults.push(RequestFault::parameter(name, "must be true or false"));
            false
        }
    }
}

fn ids(value: &str) -> Result<Vec<JobId>, String> {
    let texts: Vec<&str> = value.split(',').collect();
    if texts.len() > MAX_IDS {
        return Err(format!("may have at most {MAX_IDS} ids, not {}", texts.len()));
    }
    let id = |text: &&str| {
        parse_id(text.trim()).ok_or_else(|| format!("must be ids of models, separated by commas; `{text}` is none"))
    };
    texts.iter().map(id).collect()
}

fn time(value: &str) -> Result<Timestamp, String> {
    value.parse().map_err(|_| "must be a time as in RFC 3339, such as 2026-01-02T03:04:05Z".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::wire::problem::Problem;

    fn read(parameters: &[(&str, &str)]) -> Result<ListFilter, Problem> {
        let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        let mut faults = Faults::default();
        let filter = super::read(&Parameters(parameters), &Caller::Anyone, &mut faults);
        Problem::check(faults).map(|()| filter)
    }

    const ID: &str = "0197a3f2-7c11-7b9e-9d35-1f2e3c4b5a69";

    #[test]
    fn conditions_combine() {
        let filter = read(&[
            ("ids", &format!("{ID}, {ID}")),
            ("label", "a:1:2"),
            ("label", "b:"),
            ("batch", ID),
            ("created_after", "2026-01-02T03:04:05+01:00"),
            ("owner", "lab"),
            ("limit", "no condition"),
        ]);
        let filter = filter.unwrap();
        assert_eq!((filter.ids.len(), filter.owner.as_deref()), (2, Some("lab")));
        assert_eq!(filter.labels, [("a".to_owned(), "1:2".to_owned()), ("b".to_owned(), String::new())]);
        assert_eq!(filter.created_after.map(|at| at.to_string()).as_deref(), Some("2026-01-02T02:04:05Z"));
        assert_eq!(filter.batch.map(|id| id.to_string()).as_deref(), Some(ID));
    }

    #[test]
    fn each_fault_names_its_parameter() {
        let many = [ID; MAX_IDS + 1].join(",");
        let wrong = [
            ("ids", ""),
            ("ids", "7"),
            ("ids", many.as_str()),
            ("batch", "7"),
            ("label", "alone"),
            ("preset", "a\0"),
            ("status", "done"),
            ("created_after", "yesterday"),
            ("created_before", "2026-01-02"),
        ];
        for (name, value) in wrong {
            let body = serde_json::to_value(read(&[(name, value)]).unwrap_err().body("", "")).unwrap();
            assert_eq!(body["errors"][0]["parameter"], name, "{value}");
        }
        let all = serde_json::to_value(read(&wrong).unwrap_err().body("", "")).unwrap();
        assert_eq!(all["errors"].as_array().map(Vec::len), Some(wrong.len()));
    }
}
