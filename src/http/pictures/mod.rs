//! Pictures and other views of stored models, created on request.
//!
//! | file | subject |
//! |---|---|
//! | `preview`, `slides` | pictures of a model, and of its sections as histological slides |
//! | `sections`, `cut`, `course` | recorded sections, planar cuts of the surface, the centre line |
//! | `way` | the way through the lumen |
//! | `report_page` | the report as a page |
//! | `draw`, `queue` | drawing a picture; turns, and the pictures and surfaces kept in memory |
//! | `surfaces` | surfaces, read from the artifact store |

pub(in crate::http) mod course;
pub(in crate::http) mod cut;
pub(in crate::http) mod draw;
pub(in crate::http) mod preview;
pub(in crate::http) mod queue;
pub(in crate::http) mod report_page;
pub(in crate::http) mod sections;
pub(in crate::http) mod slides;
mod surfaces;
pub(in crate::http) mod way;
