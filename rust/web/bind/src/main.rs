//! Writes the JavaScript and TypeScript beside a compiled `rust/web`, and the module that they load:
//! `octoarm-web-bind MODULE.wasm FOLDER`. It is `wasm-bindgen --target web` in the very version of the
//! library, which `Cargo.lock` keeps.

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [module, folder] = arguments.as_slice() else {
        return Err("expected MODULE.wasm FOLDER".into());
    };
    let mut bindings = wasm_bindgen_cli_support::Bindgen::new();
    bindings.input_path(module).web(true)?.omit_default_module_path(false).typescript(true);
    bindings.generate(folder)?;
    Ok(())
}
