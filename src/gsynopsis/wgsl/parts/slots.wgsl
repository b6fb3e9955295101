// The heads' outputs of a visible anchor: opacity K, covariance 7 K, colour 3 K.
fn opacity_at(v: u32, k: u32, slots: u32) -> u32 { return v * 11u * slots + k; }
fn covariance_at(v: u32, k: u32, slots: u32) -> u32 { return (v * 11u + 1u) * slots + 7u * k; }
fn color_at(v: u32, k: u32, slots: u32) -> u32 { return (v * 11u + 8u) * slots + 3u * k; }
fn activated(raw: f32) -> f32 { return 1.0 - 2.0 / (1.0 + exp(2.0 * raw)); }  // tanh
fn sigmoid(raw: f32) -> f32 { return 1.0 / (1.0 + exp(-raw)); }
