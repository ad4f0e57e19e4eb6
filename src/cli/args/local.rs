//! Options of the commands that work without a service: they grow models and read files.

use super::shared::{GpuArgs, ModelArgs, UnitArgs};
use crate::cli::units;
use crate::model::LengthUnit;
use crate::render::{MAX_SIZE, NamedView, Plane};
use clap::builder::FalseyValueParser;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Options of `generate`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct GenerateArgs {
    #[command(flatten)]
    pub(in crate::cli) model: ModelArgs,
    /// Directory for the files; created if it does not exist
    #[arg(long, value_name = "DIR", required = true)]
    pub(in crate::cli) out: PathBuf,
    #[command(flatten)]
    pub(in crate::cli) gpu: GpuArgs,
    /// Memory limit of the model, such as 2GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes_with_unit)]
    pub(in crate::cli) memory_limit: Option<u64>,
    /// Replace the files of another model in --out: those that its manifest.json names are removed
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) force: bool,
    /// Also write report.html, the report as a web page
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) report: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// Options of `compare`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct CompareArgs {
    /// Presets, separated by commas
    #[arg(long = "preset", value_name = "LIST", value_delimiter = ',', default_value = "pig,human,cow")]
    pub(in crate::cli) presets: Vec<String>,
    /// First and last seed, such as 1..20
    #[arg(long, value_name = "FIRST..LAST", value_parser = units::seeds, default_value = "1..20")]
    pub(in crate::cli) seeds: std::ops::RangeInclusive<u64>,
    /// Print how many models agree with each statement of the anatomical checklist
    /// (references/checklist.json) instead of the tables of measures
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) checklist: bool,
    /// Print JSON with the means of every model instead of tables
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// Options of `check`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct CheckArgs {
    /// Files to certify
    #[arg(value_name = "FILE", required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Euler number that every component must have
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub(in crate::cli) euler: Option<i64>,
    #[command(flatten)]
    pub(in crate::cli) unit: UnitArgs,
    /// Print a JSON array with the certificate of each file
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// Options of `convert`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct ConvertArgs {
    /// File to read
    #[arg(value_name = "FILE")]
    pub(in crate::cli) file: PathBuf,
    /// File to write; its ending selects the format: .glb, .gltf (with a .bin next to it), .obj,
    /// .stl, .ascii.stl, .ply, .vtp or .3mf
    #[arg(value_name = "OUT")]
    pub(in crate::cli) out: PathBuf,
    /// Unit to write: m, mm or um [default: m in OBJ and glTF, mm in STL, PLY, VTP
    /// and 3MF]
    #[arg(long, value_name = "UNIT", value_parser = units::named::<LengthUnit>)]
    pub(in crate::cli) units: Option<LengthUnit>,
    #[command(flatten)]
    pub(in crate::cli) unit: UnitArgs,
    /// Factor by which the surface is enlarged, such as 20. The command then prints the size, the
    /// least wall thickness and the least gap, as for every .3mf
    #[arg(long, value_name = "FACTOR", value_parser = factor, allow_hyphen_values = true)]
    pub(in crate::cli) scale: Option<f64>,
    /// Write STL as text, with one solid per patch
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) ascii: bool,
}

/// Options of `report`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct ReportArgs {
    /// Directory with the report.json and sections.bin of a model
    #[arg(value_name = "DIR")]
    pub(in crate::cli) dir: PathBuf,
    /// File for the page [default: report.html in DIR]
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) out: Option<PathBuf>,
}

/// Options of `render`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct RenderArgs {
    /// Files to draw; the tube runs along z, and y is up
    #[arg(value_name = "FILE", required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Directory for the pictures, which are named after the files; or the picture itself, if PATH
    /// ends in .png
    #[arg(long, value_name = "PATH", default_value = ".")]
    pub(in crate::cli) out: PathBuf,
    /// View: whole, opened (without the quarter where x and y are above the middle), isthmus or
    /// ampulla (the ends)
    #[arg(long, value_name = "NAME", default_value = NamedView::default().name())]
    pub(in crate::cli) view: NamedView,
    /// Azimuth of the camera, degrees around y, instead of the view's: 0 faces the ampulla end, 90
    /// looks from +x
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(in crate::cli) azimuth: Option<f64>,
    /// Elevation of the camera, degrees above the horizontal plane, instead of the view's, -89 to
    /// 89
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(in crate::cli) elevation: Option<f64>,
    /// Longest side of a picture, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=i64::from(MAX_SIZE)), default_value_t = 1024)]
    pub(in crate::cli) size: u32,
    /// Plane that cuts away the part in front of it, instead of the view's cut: z=12mm removes
    /// larger z, -z=12mm removes smaller z; 1,1,0=2mm removes everything farther than 2 mm from the
    /// origin in the direction x = y. Lengths in um, mm, cm or m. With several planes, only the
    /// part in front of all of them is removed
    #[arg(long, value_name = "PLANE", value_parser = units::plane, value_delimiter = ';', allow_hyphen_values = true)]
    pub(in crate::cli) cut: Vec<Plane>,
    /// Preset whose tissue layers are drawn on cut faces [default: the model of the report.json or
    /// sections.bin, else pig]
    #[arg(long, value_name = "NAME")]
    pub(in crate::cli) preset: Option<String>,
    /// Draw each surface in one colour, without stained layers, texture and relief
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) plain: bool,
    #[command(flatten)]
    pub(in crate::cli) unit: UnitArgs,
}

/// Options of `section`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct SectionArgs {
    /// The sections.bin file of a model
    #[arg(value_name = "FILE")]
    pub(in crate::cli) file: PathBuf,
    /// Index of the section, from 0 at the isthmus end
    #[arg(long, value_name = "K")]
    pub(in crate::cli) index: u32,
    /// Directory for the picture (section-K.png or section-K-labels.png); or the picture itself, if
    /// PATH ends in .png
    #[arg(long, value_name = "PATH", default_value = ".")]
    pub(in crate::cli) out: PathBuf,
    /// Longer side of the picture, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=i64::from(MAX_SIZE)), default_value_t = 1024)]
    pub(in crate::cli) size: u32,
    /// Write the tissue label of each pixel as a grey value instead of a stained picture: 0
    /// outside, 1 lumen, 2 epithelium, 3 lamina propria, 4 circular muscle, 5 longitudinal muscle,
    /// 6 serosa, 7 subserosa, 8 inner longitudinal muscle, 9 vessel
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) labels: bool,
    #[command(flatten)]
    pub(in crate::cli) layers: LayerArgs,
}

/// Heights of the tissue layers in pictures.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct LayerArgs {
    /// Height of the epithelium, such as 20um [default: the value of the model's preset]
    #[arg(long, value_name = "LENGTH", value_parser = units::length_um)]
    epithelium: Option<f64>,
    /// Minimum thickness of the lamina propria under the epithelium, such as 30um [default: the
    /// value of the model's preset]
    #[arg(long, value_name = "LENGTH", value_parser = units::length_um)]
    lamina: Option<f64>,
    /// Fraction of the muscle that is the longitudinal layer, 0 to 1 [default: the value of the
    /// model's preset]
    #[arg(long, value_name = "SHARE")]
    pub(in crate::cli) longitudinal_share: Option<f64>,
    /// Thickness of the serosa, such as 50um [default: the value of the model's preset]
    #[arg(long, value_name = "LENGTH", value_parser = units::length_um)]
    serosa: Option<f64>,
    /// --epithelium in µm, without a unit
    #[arg(long, value_name = "UM", conflicts_with = "epithelium")]
    epithelium_um: Option<f64>,
    /// --lamina in µm, without a unit
    #[arg(long, value_name = "UM", conflicts_with = "lamina")]
    lamina_um: Option<f64>,
    /// --serosa in µm, without a unit
    #[arg(long, value_name = "UM", conflicts_with = "serosa")]
    serosa_um: Option<f64>,
}

impl LayerArgs {
    /// Given lengths by their names in the spec, µm.
    pub(in crate::cli) fn lengths_um(&self) -> [(&'static str, Option<f64>); 3] {
        [
            ("epithelium_um", self.epithelium.or(self.epithelium_um)),
            ("lamina_um", self.lamina.or(self.lamina_um)),
            ("serosa_um", self.serosa.or(self.serosa_um)),
        ]
    }
}

/// Options of `cut`.
#[derive(Clone, Debug, Args)]
#[command(group = clap::ArgGroup::new("across").args(["z", "z_um"]))]
#[command(group = clap::ArgGroup::new("through").args(["origin", "origin_um"]).conflicts_with("across"))]
#[command(group = clap::ArgGroup::new("place").required(true).args(["z", "z_um", "origin", "origin_um"]))]
pub(in crate::cli) struct CutArgs {
    /// Surface of the tissue: glTF (.glb, .gltf), OBJ, STL, PLY or VTP
    #[arg(value_name = "FILE")]
    pub(in crate::cli) file: PathBuf,
    /// Position along the tube of a plane across it, such as 42mm; along the centre line if the
    /// tube is bent
    #[arg(long, value_name = "LENGTH", value_parser = units::length_um, allow_hyphen_values = true)]
    z: Option<f64>,
    /// --z in µm, without a unit
    #[arg(long, value_name = "UM", allow_hyphen_values = true)]
    z_um: Option<f64>,
    /// Report of the model, whose spec contains the course of a bent tube [default: report.json
    /// next to FILE, if it exists]
    #[arg(long, value_name = "FILE", requires = "across")]
    pub(in crate::cli) report: Option<PathBuf>,
    /// Point on the plane, such as 0,1.5mm,42mm
    #[arg(long, value_name = "X,Y,Z", value_parser = units::point_um, allow_hyphen_values = true, requires = "normal")]
    origin: Option<[f64; 3]>,
    /// --origin in µm, without units
    #[arg(long, value_name = "X,Y,Z", value_parser = units::triple, allow_hyphen_values = true, requires = "normal")]
    origin_um: Option<[f64; 3]>,
    /// Normal of the plane, of any length
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = units::triple,
        allow_hyphen_values = true,
        requires = "through",
        conflicts_with = "across"
    )]
    pub(in crate::cli) normal: Option<[f64; 3]>,
    #[command(flatten)]
    pub(in crate::cli) unit: UnitArgs,
    /// File for the cut: .json (rings and areas), .svg (a drawing) or .png (a stained picture, or
    /// tissue labels with --labels) [default: none; areas and islands are printed]
    #[arg(long, value_name = "PATH")]
    pub(in crate::cli) out: Option<PathBuf>,
    /// File for the part on one side of the plane as a closed surface, certified: .stl, .3mf, .glb,
    /// .obj, .ply or .vtp. The face of the cut is the patch cut. The plane has no limits, so it
    /// also cuts other parts of a bent tube
    #[arg(long, value_name = "PATH")]
    pub(in crate::cli) solid: Option<PathBuf>,
    /// Part that --solid keeps: front, to which the normal points (greater z), or back
    #[arg(long, value_name = "SIDE", value_enum, default_value_t = Side::Front, requires = "solid")]
    pub(in crate::cli) side: Side,
    /// Thickness of the slab that --solid keeps, such as 500um. Its other face is the patch
    /// cut_back [default: all on this side]
    #[arg(long, value_name = "LENGTH", value_parser = units::positive_length_um, requires = "solid")]
    pub(in crate::cli) thick: Option<f64>,
    /// Longer side of a .png, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=i64::from(MAX_SIZE)), default_value_t = 1024)]
    pub(in crate::cli) size: u32,
    /// For a .png: write the tissue label of each pixel as a grey value instead of a stained
    /// picture: 0 outside, 1 lumen, 2 epithelium, 3 lamina propria, 4 circular muscle, 5
    /// longitudinal muscle, 6 serosa, 7 subserosa, 8 inner longitudinal muscle, 9 vessel
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) labels: bool,
    /// Preset of the model, for the heights of its tissue layers
    #[arg(long, value_name = "NAME", default_value = crate::spec::DEFAULT_PRESET)]
    pub(in crate::cli) preset: String,
    #[command(flatten)]
    pub(in crate::cli) layers: LayerArgs,
}

impl CutArgs {
    /// Position along the tube, µm.
    pub(in crate::cli) fn across_um(&self) -> Option<f64> {
        self.z.or(self.z_um)
    }

    /// Point on the plane, µm.
    pub(in crate::cli) fn point_um(&self) -> Option<[f64; 3]> {
        self.origin.or(self.origin_um)
    }
}

/// Side of a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum Side {
    /// The side to which the normal points.
    Front,
    /// The other side.
    Back,
}

impl Side {
    /// Word for what lies on this side of a plane.
    pub(in crate::cli) fn name(self) -> &'static str {
        match self {
            Self::Front => "in front of",
            Self::Back => "behind",
        }
    }
}

fn factor(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(factor) if factor.is_finite() && factor > 0.0 => Ok(factor),
        _ => Err(format!("`{text}` is not a number above 0")),
    }
}
