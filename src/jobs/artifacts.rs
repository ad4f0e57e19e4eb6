//! Files of models, through object_store (the only user of it).
