//! Temporary.
#[path = "../src/cli/bench.rs"]
mod bench;
use clap::Parser;
#[derive(clap::Parser)]
struct Cli {
    #[command(flatten)]
    args: bench::Args,
}
struct P(std::time::Instant);
impl manyview_pipeline::bake::Progress for P {
    fn begin(&self, step: &'static str, total: u64, unit: &'static str) {
        eprintln!("{:.1}s {step} {total} {unit}", self.0.elapsed().as_secs_f64());
    }
}
fn main() {
    let cli = Cli::parse();
    let p = P(std::time::Instant::now());
    if let Err(e) = bench::run(&cli.args, &p, |t| print!("{t}")) {
        eprintln!("{e}");
        std::process::exit(1);
    }
    eprintln!("{:.1}s done", p.0.elapsed().as_secs_f64());
}
