//! Short loops over joints, written out for the usual six: counters and addresses are a third of what such a loop executes.

/// The same statement for several constants.
macro_rules! unrolled {
    ($k:ident in $($value:literal)* => $body:expr) => {
        $({
            const $k: usize = $value;
            $body
        })*
    };
}

/// The same short statement for joints `0` to `n - 1`.
macro_rules! for_joints {
    ($j:ident in $n:expr => $body:expr) => {
        if $n == 6 {
            for_joints!(@one $j 0 $body);
            for_joints!(@one $j 1 $body);
            for_joints!(@one $j 2 $body);
            for_joints!(@one $j 3 $body);
            for_joints!(@one $j 4 $body);
            for_joints!(@one $j 5 $body);
        } else {
            for $j in 0..$n {
                $body;
            }
        }
    };
    (@one $j:ident $value:literal $body:expr) => {{
        let $j: usize = $value;
        $body;
    }};
}

pub(crate) use {for_joints, unrolled};
