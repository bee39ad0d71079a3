#pragma once

/// Heap allocations of the calling thread since it began: malloc, calloc, realloc and their aligned
/// kin, and with them new, Eigen and every C library. Allocates nothing, takes no lock.
///
/// Comes either linked in (tests) or preloaded (libtandem_allocations.so, `./tandem bench loop`). A
/// program that counts only when the library is there declares it weak and asks whether it is null.
extern "C" long tandem_allocations();
