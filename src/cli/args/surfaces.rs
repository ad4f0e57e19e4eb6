//! Options of commands that read files of surfaces and sections.

use crate::cli::units;
use crate::model::LengthUnit;
use crate::render::{MAX_SIZE, NamedView, Plane};
use clap::Args;
use clap::builder::FalseyValueParser;
use std::path::PathBuf;

/// Options of `check`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct CheckArgs {
    /// Files to certify
    #[arg(value_name = "FILE", required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Euler number that every component must have
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub(in crate::cli) euler: Option<i64>,
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
    /// File to write; its ending tells the format: .glb, .gltf (with a .bin beside it), .obj, .stl, .ascii.stl, .ply or .vtp
    #[arg(value_name = "OUT")]
    pub(in crate::cli) out: PathBuf,
    /// Unit to write: m, mm or um [default: m in OBJ and glTF, mm in STL, PLY and VTP]
    #[arg(long, value_name = "UNIT", value_parser = units::named::<LengthUnit>)]
    pub(in crate::cli) units: Option<LengthUnit>,
    /// Unit of FILE: m, mm or um [default: what the file states, or m]
    #[arg(long, value_name = "UNIT", value_parser = units::named::<LengthUnit>)]
    pub(in crate::cli) from_units: Option<LengthUnit>,
    /// Write STL as text, one solid for each patch
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) ascii: bool,
}

/// Options of `report`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct ReportArgs {
    /// Directory with the report.json and the sections.bin of a model
    #[arg(value_name = "DIR")]
    pub(in crate::cli) dir: PathBuf,
    /// The page [default: report.html in DIR]
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) out: Option<PathBuf>,
}

/// Options of `render`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct RenderArgs {
    /// Files to draw; the tube is along z, and y is up
    #[arg(value_name = "FILE", required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Directory for the pictures, which are named like the files; or the picture itself, if PATH ends in .png
    #[arg(long, value_name = "PATH", default_value = ".")]
    pub(in crate::cli) out: PathBuf,
    /// View: whole, opened (without the quarter x, y > middle), isthmus or ampulla (the ends)
    #[arg(long, value_name = "NAME", default_value = NamedView::default().name())]
    pub(in crate::cli) view: NamedView,
    /// Look from this many degrees around y instead: 0 looks at the ampulla end, 90 comes from +x
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(in crate::cli) azimuth: Option<f64>,
    /// Look from this many degrees above the horizontal plane instead, -89 to 89
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(in crate::cli) elevation: Option<f64>,
    /// Longest side, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=i64::from(MAX_SIZE)), default_value_t = 1024)]
    pub(in crate::cli) size: u32,
    /// Cut away one side of a plane, instead of the cut of the view: z=12mm removes what has a greater z, -z=12mm what has a
    /// lesser one; 1,1,0=2mm removes what lies farther than 2 mm from the origin in direction x = y. Lengths in um, mm, cm or m.
    /// Of several planes, only what all of them would remove is cut away
    #[arg(long, value_name = "PLANE", value_parser = units::plane, value_delimiter = ';', allow_hyphen_values = true)]
    pub(in crate::cli) cut: Vec<Plane>,
}

/// Options of `section`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct SectionArgs {
    /// The sections.bin of a model
    #[arg(value_name = "FILE")]
    pub(in crate::cli) file: PathBuf,
    /// Index of the section, from 0 at the isthmus end
    #[arg(long, value_name = "K")]
    pub(in crate::cli) index: u32,
    /// Directory for the picture, which is named section-K.png or section-K-labels.png; or the picture itself, if PATH ends
    /// in .png
    #[arg(long, value_name = "PATH", default_value = ".")]
    pub(in crate::cli) out: PathBuf,
    /// Longer side, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=i64::from(MAX_SIZE)), default_value_t = 1024)]
    pub(in crate::cli) size: u32,
    /// Write the tissue of each pixel as a grey value instead of a stain: 0 outside, 1 lumen, 2 epithelium, 3 lamina propria,
    /// 4 circular muscle, 5 longitudinal muscle, 6 serosa
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) labels: bool,
    #[command(flatten)]
    pub(in crate::cli) layers: LayerArgs,
}

/// Heights of the layers in pictures.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct LayerArgs {
    /// Height of the epithelium, µm [default: that of the model's preset]
    #[arg(long, value_name = "UM")]
    pub(in crate::cli) epithelium_um: Option<f64>,
    /// Least thickness of the lamina propria under the epithelium, µm [default: that of the model's preset]
    #[arg(long, value_name = "UM")]
    pub(in crate::cli) lamina_um: Option<f64>,
    /// Share of the longitudinal layer in the muscle, 0 to 1 [default: that of the model's preset]
    #[arg(long, value_name = "SHARE")]
    pub(in crate::cli) longitudinal_share: Option<f64>,
    /// Thickness of the serosa, µm [default: that of the model's preset]
    #[arg(long, value_name = "UM")]
    pub(in crate::cli) serosa_um: Option<f64>,
}

/// Options of `cut`.
#[derive(Clone, Debug, Args)]
#[command(group = clap::ArgGroup::new("place").required(true).multiple(true).args(["z_um", "origin_um", "normal"]))]
pub(in crate::cli) struct CutArgs {
    /// Surface of the tissue: glTF (.glb, .gltf), OBJ, STL, PLY or VTP
    #[arg(value_name = "FILE")]
    pub(in crate::cli) file: PathBuf,
    /// Place along the tube of a plane across it, µm; along its centre line, if it is bent
    #[arg(long, value_name = "Z", allow_hyphen_values = true, conflicts_with_all = ["origin_um", "normal"])]
    pub(in crate::cli) z_um: Option<f64>,
    /// Report of the model, whose spec says how the tube is bent [default: report.json beside FILE, if there is one]
    #[arg(long, value_name = "FILE", requires = "z_um")]
    pub(in crate::cli) report: Option<PathBuf>,
    /// A point of the plane, µm
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, requires = "normal")]
    pub(in crate::cli) origin_um: Option<[f64; 3]>,
    /// Normal of the plane, of any length
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, requires = "origin_um")]
    pub(in crate::cli) normal: Option<[f64; 3]>,
    /// File for the cut: .json (rings and areas), .svg (a drawing) or .png (stained, or --labels) [default: none; areas and islands
    /// are printed]
    #[arg(long, value_name = "PATH")]
    pub(in crate::cli) out: Option<PathBuf>,
    /// Longer side of a .png, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=i64::from(MAX_SIZE)), default_value_t = 1024)]
    pub(in crate::cli) size: u32,
    /// As .png: the tissue of each pixel as a grey value instead of a stain: 0 outside, 1 lumen, 2 epithelium, 3 lamina propria,
    /// 4 circular muscle, 5 longitudinal muscle, 6 serosa
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) labels: bool,
    /// Preset of the model, for the heights of its layers
    #[arg(long, value_name = "NAME", default_value = crate::spec::DEFAULT_PRESET)]
    pub(in crate::cli) preset: String,
    #[command(flatten)]
    pub(in crate::cli) layers: LayerArgs,
}

fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| "must be three numbers, x,y,z".into())
}

/// Options of `measure`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct MeasureArgs {
    /// PNG of one whole section, grey or with a palette: a mask, or an image whose values are labels
    #[arg(value_name = "IMAGE")]
    pub(in crate::cli) image: PathBuf,
    /// Side of a pixel, 0.05 to 100 µm
    #[arg(long, value_name = "UM")]
    pub(in crate::cli) pixel_um: f64,
    /// Values that are tissue, separated by commas: grey values or indices of the palette [default: all but 0]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub(in crate::cli) tissue: Vec<u8>,
    /// Print a JSON object: the settings, and the value of each quantity
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}
