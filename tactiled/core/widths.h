/* Compiles BODY (a header's name) once for every width of the machine's vectors, and picks one when it is called.

   A body is written for vectors of WIDTH floats: NAME(vec); NAME(loose) is one anywhere in memory, NAME(bits) its bits.
   A processor with FMA rounds a product and its sum once, another twice. */

#ifndef CORE_WIDTHS
#define CORE_WIDTHS

#define PASTE_(name, width) name##_##width
#define PASTE(name, width) PASTE_(name, width)
#define NAME(name) PASTE(name, WIDTH)

#define VECTORS(width) \
  typedef float vec_##width __attribute__((vector_size(4 * width))); \
  typedef float loose_##width __attribute__((vector_size(4 * width), aligned(4), may_alias)); \
  typedef int bits_##width __attribute__((vector_size(4 * width)));
VECTORS(4)
VECTORS(8)
VECTORS(16)

/* Floats in a vector of this machine, at most `values`, and 4 at least. */
static int vector_width(long values) {
#if defined(__x86_64__)
  if (values >= 16 && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512bw"))
    return 16;
  if (values >= 8 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return 8;
#endif
  (void)values;
  return 4;
}
#if defined(__x86_64__)
#define AT_WIDTH(width, name, ...) \
  ((width) == 16 ? name##_16(__VA_ARGS__) : (width) == 8 ? name##_8(__VA_ARGS__) : name##_4(__VA_ARGS__))
#else
#define AT_WIDTH(width, name, ...) ((void)(width), name##_4(__VA_ARGS__))
#endif

#endif

#if defined(__x86_64__)
#define TARGET __attribute__((target("avx512f,avx512vl,avx512bw,avx512dq,avx2,fma,prefer-vector-width=512")))
#define WIDTH 16
#include BODY
#undef WIDTH
#undef TARGET
#define TARGET __attribute__((target("avx2,fma")))
#define WIDTH 8
#include BODY
#undef WIDTH
#undef TARGET
#endif
#define TARGET
#define WIDTH 4
#include BODY
#undef WIDTH
#undef TARGET
