//! Options that several commands have.

use crate::cli::remote::Key;
use crate::cli::units::{self, NamedUnit};
use crate::generate::{Backend, Output, Outputs};
use crate::model::{BodyKind, LengthUnit};
use clap::Args;
use clap::builder::FalseyValueParser;
use std::fmt;
use std::path::PathBuf;

/// Spec and seed of a model.
#[derive(Clone, Debug, Args)]
pub struct SpecArgs {
    /// Preset to start from; see `oviduct presets`
    #[arg(long, value_name = "NAME", default_value = "pig")]
    pub(in crate::cli) preset: String,
    /// Seed of the random numbers, 0 to 2^53 - 1 [default: random]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..crate::spec::SEED_MAX + 1))]
    pub(in crate::cli) seed: Option<u64>,
    /// JSON file with a merge patch on the preset; `-` reads stdin
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) spec: Option<PathBuf>,
    /// Value of one parameter of the spec, as JSON or a plain string, such as collision.gap_um=30;
    /// may be repeated
    #[arg(long, value_name = "A.B=V", value_delimiter = ';')]
    pub(in crate::cli) set: Vec<String>,
}

/// Model to grow.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct ModelArgs {
    #[command(flatten)]
    pub(in crate::cli) of: SpecArgs,
    /// Backend that computes the model: auto, gpu, cpu or cpu-single
    #[arg(long, value_parser = units::named::<Backend>, default_value = "auto")]
    pub(in crate::cli) backend: Backend,
    /// Formats of the model, separated by commas: glb, gltf, obj, stl, stl-ascii, ply, vtp, 3mf,
    /// centreline, lod, labels. sections.bin, report.json and manifest.json are always written
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = units::named::<Output>, default_value = "glb,lod")]
    outputs: Vec<Output>,
    /// Bodies whose surfaces are written, separated by commas: tissue (model.*), lumen (lumen.*),
    /// regions (both, with one common wall: regions.*)
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = units::named::<BodyKind>, default_value = "tissue")]
    bodies: Vec<BodyKind>,
    /// Unit of coordinates: m, mm or um; glTF always uses metres [default: m in OBJ, mm in STL,
    /// PLY, VTP, 3MF and the centre line]
    #[arg(long, value_name = "UNIT", value_parser = units::named::<LengthUnit>)]
    units: Option<LengthUnit>,
}

impl ModelArgs {
    /// Files to write.
    pub(in crate::cli) fn outputs(&self) -> Outputs {
        Outputs { formats: self.outputs.clone(), bodies: self.bodies.clone(), units: self.units }
    }
}

/// Selection of GPUs.
#[derive(Clone, Debug, Args)]
pub struct GpuArgs {
    /// GPUs to use: auto (all), off, or one of them by its number, from 0, or a part of its name
    #[arg(long, value_name = "WHICH", value_parser = GpuUse::parse, default_value_t = GpuUse::Auto)]
    pub gpu: GpuUse,
    /// Also use software adapters, which compute on the CPU (Mesa's llvmpipe); slow, for tests
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub allow_software_adapter: bool,
}

/// Use of GPUs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GpuUse {
    /// All GPUs of this machine.
    Auto,
    /// No GPU.
    Off,
    /// The GPU with this number or this part of its name, and no other; see [`choose`].
    ///
    /// [`choose`]: crate::sim::gpu::choose
    One(String),
}

impl GpuUse {
    fn parse(text: &str) -> Result<Self, String> {
        match text.trim() {
            "" => Err("must be auto, off, or a GPU by its number or a part of its name".to_owned()),
            "auto" => Ok(Self::Auto),
            "off" => Ok(Self::Off),
            choice => Ok(Self::One(choice.to_owned())),
        }
    }
}

impl fmt::Display for GpuUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Off => "off",
            Self::One(choice) => choice,
        })
    }
}

/// Unit of a surface that is read.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(in crate::cli) struct UnitArgs {
    /// Unit of the coordinates in FILE: um, mm, cm or m; it overrides the unit that the file states
    /// [default: the unit that the file states, or m]
    #[arg(long, value_name = "UNIT", value_parser = units::length_unit)]
    pub(in crate::cli) from_units: Option<NamedUnit>,
}

/// Location of the job store.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct DatabaseArgs {
    /// Directory for the database, the artifacts and the scratch directory, unless these are set
    /// separately
    #[arg(long, value_name = "DIR", default_value = "data")]
    pub(in crate::cli) data: PathBuf,
    /// Database of the job store: `postgres://USER:PASSWORD@HOST/NAME`, `sqlite:PATH` or a path
    /// [default: DATA/oviduct.db]
    #[arg(long, value_name = "URL")]
    pub(in crate::cli) database: Option<String>,
}

/// Options of `scrub`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct ScrubArgs {
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
    /// Artifact store: `s3://BUCKET/PREFIX` with the usual AWS_… variables, `file:PATH` or a path
    /// [default: DATA/artifacts]
    #[arg(long, value_name = "URL")]
    pub(in crate::cli) artifacts: Option<String>,
    /// Print a JSON object with all differences instead of text
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// Address of a service and the API key for it.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct RemoteArgs {
    /// Address of the service
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub(in crate::cli) url: String,
    /// API key, sent as `Authorization: Bearer`. Other users of this machine can see command lines,
    /// so prefer the variable OVIDUCT_KEY [default: none]
    #[arg(long, value_name = "SECRET")]
    pub(in crate::cli) key: Option<Key>,
}
