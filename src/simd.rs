//! Functions compiled for several vector instruction sets, chosen at run time.

/// Vector instructions that the CPU has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SimdLevel {
    /// What the compiler was told that every machine has.
    Portable,
    /// AVX2.
    Avx2,
    /// AVX-512 with its doubleword, byte and conflict detection parts.
    Avx512,
}

impl SimdLevel {
    /// The best that this machine has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            if has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl") {
                return Self::Avx512;
            }
            if has!("avx2") && has!("bmi2") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }
}

/// Asks for an element that will be read soon; nothing happens if there is none.
#[inline(always)]
pub(crate) fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(element) = slice.get(index) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        #[allow(unsafe_code, reason = "there is no safe way to prefetch")]
        // SAFETY: the pointer is to an element of the slice, and a prefetch reads nothing anyway. Tested with all that
        // tests lights: `lights_and_segments_say_the_same`.
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(element).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        _ = (slice, index);
    }
}

/// Compiles a function for each [`SimdLevel`] and chooses at run time.
macro_rules! dispatched {
    ($(#[$doc:meta])* $name:ident = $body:ident($($arg:ident: $type:ty),* $(,)?)) => {
        $(#[$doc])*
        pub(crate) fn $name(level: SimdLevel, $($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
                fn with_avx512($($arg: $type),*) {
                    $body($($arg),*);
                }
                #[target_feature(enable = "avx2,bmi2")]
                fn with_avx2($($arg: $type),*) {
                    $body($($arg),*);
                }
                match level.min(SimdLevel::detect()) {
                    #[allow(unsafe_code, reason = "calling a function compiled for AVX-512")]
                    // SAFETY: `detect` found these features. Tested: `all_levels_agree`.
                    SimdLevel::Avx512 => return unsafe { with_avx512($($arg),*) },
                    #[allow(unsafe_code, reason = "calling a function compiled for AVX2")]
                    // SAFETY: `detect` found these features. Tested: `all_levels_agree`.
                    SimdLevel::Avx2 => return unsafe { with_avx2($($arg),*) },
                    SimdLevel::Portable => {}
                }
            }
            _ = level;
            $body($($arg),*);
        }
    };
}
pub(crate) use dispatched;
