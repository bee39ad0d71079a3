#pragma once

#include <filesystem>
#include <string>

namespace tandem {

/// The text of panda.xml, given the arm's covers as visual meshes: in each link a mesh geom that
/// touches nothing for every file linkN.obj or linkN_M.obj in `meshes` (geom group 3 for links 0 to
/// 5, group 1 for the rest and the hand). For the renderer only; the simulation never loads meshes.
/// @throws std::runtime_error with a sentence if a file cannot be read or the folder lacks a link.
std::string with_covers(const std::filesystem::path& panda_xml,
                        const std::filesystem::path& meshes);

/// The folder of such meshes that the package gym-hil brings into ROOT/.venv; empty if it is not
/// there.
std::filesystem::path find_covers(const std::filesystem::path& root);

}  // namespace tandem
