# Trees that look for mistakes which ordinary tests pass over; `./tandem test --sanitizer` and `--fuzz` make and run them.
#   thread   data races (gcc)
#   address  memory errors, leaks, undefined behaviour (gcc)
#   fuzz     coverage for libFuzzer, with the checks of `address` (clang)
# Libraries of the system stay as they are: what they do among themselves is not seen, or named in tests/sanitizers/.
set(TANDEM_SANITIZE "" CACHE STRING "thread, address or fuzz; empty: none")
set_property(CACHE TANDEM_SANITIZE PROPERTY STRINGS "" thread address fuzz)

if(TANDEM_SANITIZE STREQUAL "")
  return()
elseif(TANDEM_SANITIZE STREQUAL "thread")
  set(sanitizers -fsanitize=thread)
elseif(TANDEM_SANITIZE STREQUAL "address")
  set(sanitizers -fsanitize=address,undefined -fno-sanitize-recover=all)
elseif(TANDEM_SANITIZE STREQUAL "fuzz")
  if(NOT CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
    message(FATAL_ERROR "TANDEM_SANITIZE=fuzz needs clang, the compiler is ${CMAKE_CXX_COMPILER_ID}; "
      "configure a tree of its own with -DCMAKE_C_COMPILER=clang-14 -DCMAKE_CXX_COMPILER=clang++-14.")
  endif()
  set(sanitizers -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all)
else()
  message(FATAL_ERROR "TANDEM_SANITIZE is '${TANDEM_SANITIZE}'; it must be thread, address, fuzz or empty.")
endif()

add_compile_options(${sanitizers} -g1 -fno-omit-frame-pointer)
add_link_options(${sanitizers})
# Warnings are the business of the ordinary tree: instrumented code raises false ones.
add_compile_options(-Wno-error)
