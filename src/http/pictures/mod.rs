//! What is drawn or cut from a stored model when it is asked for.
//!
//! | file | subject |
//! |---|---|
//! | `preview`, `slides` | pictures of a model, and of its sections as histological slides |
//! | `sections`, `cut`, `course` | recorded sections, planar cuts of the surface, the centreline |
//! | `report_page` | the report as a page |
//! | `queue`, `draw` | how many pictures are drawn at a time, and the answer with one |
//! | `surfaces`, `bodies` | surfaces that are read from the artifact store, and those kept in memory |

pub(in crate::http) mod bodies;
pub(in crate::http) mod course;
pub(in crate::http) mod cut;
pub(in crate::http) mod draw;
pub(in crate::http) mod preview;
pub(in crate::http) mod queue;
pub(in crate::http) mod report_page;
pub(in crate::http) mod sections;
pub(in crate::http) mod slides;
pub(in crate::http) mod surfaces;
