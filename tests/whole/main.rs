//! Tests of the project as a whole: the files around the code, outputs of the commands, recorded
//! digests. One program, because each test program links the whole service.

mod architecture;
mod check_files;
mod corpus;
mod deploy;
mod golden;
mod links;
mod monitoring;
mod openapi;
mod shaders;
mod signals;
