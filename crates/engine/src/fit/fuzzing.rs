//! Fuzz target: the request for a fit.

use super::{FitSpec, read_images};
use serde_json::Value;

/// Asserts that an accepted request is accepted again in its canonical form, and that its models at
/// both ends of the bounds are valid or refused with a pointer. A refusal must have a pointer.
pub fn fit(bytes: &[u8]) {
    let Ok(mut body) = serde_json::from_slice::<Value>(bytes) else { return };
    let images = body.as_object_mut().and_then(|members| members.remove("images"));
    let measured = match images.map(|images| read_images(&images)) {
        None => Vec::new(),
        Some(Ok(targets)) => targets,
        Some(Err(faults)) => {
            assert!(!faults.is_empty() && faults.iter().all(|fault| fault.pointer.starts_with("/images")));
            return;
        }
    };
    match FitSpec::read(&body, measured, &[]) {
        Ok(fit) => {
            assert_eq!(FitSpec::read(&fit.to_json(), Vec::new(), &[]).as_ref(), Ok(&fit));
            for place in [0.0, 0.5, 1.0] {
                if let Err(faults) = fit.at(&vec![place; fit.variables.len()]) {
                    assert!(!faults.is_empty() && faults.iter().all(|fault| fault.pointer.starts_with('/')));
                }
            }
        }
        Err(faults) => assert!(!faults.is_empty()),
    }
}
