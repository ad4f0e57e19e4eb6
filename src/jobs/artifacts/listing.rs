//! Lists of the objects below a prefix, in pages.

use super::error::ArtifactError;
use super::local::{Object, Walk};
use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt};
use object_store::ObjectMeta;

/// Number of objects on a page. S3 lists and deletes as many in one request.
const PAGE: usize = 1000;

/// A list that is read page by page.
pub(in crate::jobs) enum Listing {
    /// List of an object store.
    Remote(BoxStream<'static, object_store::Result<ObjectMeta>>),
    /// List of a local folder; `None` after the last page.
    Local(Option<Walk>),
}

impl Listing {
    /// The next page; empty at the end.
    pub(in crate::jobs) async fn next(&mut self) -> Result<Vec<Object>, ArtifactError> {
        match self {
            Self::Remote(listed) => {
                let page = listed.take(PAGE).map_ok(|object| Object {
                    key: object.location.to_string(),
                    modified_micros: object.last_modified.timestamp_micros(),
                });
                Ok(page.try_collect().await?)
            }
            Self::Local(walk) => {
                let Some(mut moved) = walk.take() else { return Ok(Vec::new()) };
                let read = tokio::task::spawn_blocking(move || {
                    let page: Vec<Object> = moved.by_ref().take(PAGE).collect();
                    (moved, page)
                });
                let (moved, page) = read.await.map_err(ArtifactError::store)?;
                *walk = (!page.is_empty()).then_some(moved);
                Ok(page)
            }
        }
    }
}
