#include "controller/render/covers.h"

#include <algorithm>
#include <fstream>
#include <set>
#include <sstream>
#include <stdexcept>
#include <vector>

namespace tandem {
namespace {

namespace fs = std::filesystem;

// Parts of the covers that are dark or lit; all others are white.
const std::set<std::string> kDark = {"link0_1",  "link0_3",  "link0_5", "link0_9", "link3_3",
                                     "link4_2",  "link5_0",  "link6_2", "link6_9", "link6_10",
                                     "link6_14", "link6_15", "link7_1", "link7_2", "link7_3",
                                     "link7_4",  "link7_5",  "link7_6"};
const std::set<std::string> kLamp = {"link6_7", "link6_8", "link6_12"};

// The hand, in our own shapes: a housing with round ends, a dark seam, and the rail that the
// fingers run on.
const char kHand[] = R"(
<geom type="box" size="0.028 0.072 0.0285" pos="0 0 0.0305"
  contype="0" conaffinity="0" group="1"/>
<geom type="cylinder" size="0.028 0.0285" pos="0 0.072 0.0305"
  contype="0" conaffinity="0" group="1"/>
<geom type="cylinder" size="0.028 0.0285" pos="0 -0.072 0.0305"
  contype="0" conaffinity="0" group="1"/>
<geom type="box" size="0.0284 0.072 0.0012" pos="0 0 0.048" material="dark"
  contype="0" conaffinity="0" group="1"/>
<geom type="cylinder" size="0.0284 0.0012" pos="0 0.072 0.048" material="dark"
  contype="0" conaffinity="0" group="1"/>
<geom type="cylinder" size="0.0284 0.0012" pos="0 -0.072 0.048" material="dark"
  contype="0" conaffinity="0" group="1"/>
<geom type="box" size="0.013 0.088 0.0035" pos="0 0 0.0625" material="dark"
  contype="0" conaffinity="0" group="1"/>
<geom type="cylinder" size="0.036 0.003" pos="0 0 0.003" material="joint"
  contype="0" conaffinity="0" group="1"/>
)";

std::string read(const fs::path& path) {
  std::ifstream file(path);
  std::ostringstream text;
  if (!file || !(text << file.rdbuf()))
    throw std::runtime_error(path.string() + ": the file cannot be read.");
  return text.str();
}

void insert_after(std::string& text, const std::string& tag, const std::string& addition) {
  const size_t start = text.find(tag);
  const size_t end = start == std::string::npos ? start : text.find('>', start);
  if (end == std::string::npos)
    throw std::runtime_error("panda.xml: `" + tag +
                             "` is missing; the covers have no place to go.");
  text.insert(end + 1, "\n" + addition);
}

std::vector<std::string> parts_of(int link, const fs::path& meshes) {
  const std::string whole = "link" + std::to_string(link);
  std::vector<std::string> parts;
  for (const fs::directory_entry& entry : fs::directory_iterator(meshes)) {
    const std::string name = entry.path().stem().string();
    const bool numbered =
        name.rfind(whole + "_", 0) == 0 && name.find("collision") == std::string::npos;
    if (entry.path().extension() == ".obj" && (name == whole || numbered)) parts.push_back(name);
  }
  if (parts.empty())
    throw std::runtime_error(meshes.string() + ": no " + whole +
                             "*.obj; give the folder of the arm's meshes.");
  std::sort(parts.begin(), parts.end());
  return parts;
}

}  // namespace

std::string with_covers(const fs::path& panda_xml, const fs::path& meshes) {
  if (!fs::is_directory(meshes))
    throw std::runtime_error(meshes.string() + ": the folder of meshes does not exist.");
  std::string text = read(panda_xml);
  std::string assets;
  for (int link = 0; link <= 7; ++link) {
    std::string geoms;
    for (const std::string& part : parts_of(link, meshes)) {
      assets += "    <mesh name=\"" + part + "\" file=\"" +
                fs::absolute(meshes / (part + ".obj")).string() + "\"/>\n";
      const std::string material = kDark.count(part)   ? "dark"
                                   : kLamp.count(part) ? "lamp"
                                                       : "cover";
      geoms += "<geom type=\"mesh\" mesh=\"" + part + "\" material=\"" + material +
               "\" contype=\"0\" conaffinity=\"0\" group=\"" + (link < 6 ? "3" : "1") + "\"/>\n";
    }
    insert_after(text, "<body name=\"link" + std::to_string(link) + "\"", geoms);
  }
  insert_after(text, "<body name=\"hand\"", kHand);
  assets += "    <material name=\"lamp\" rgba=\"0.1 0.6 0.85 1\" emission=\"0.4\"/>\n";
  insert_after(text, "<asset", assets);
  insert_after(text, "<mujoco", "<compiler convexhull=\"false\"/>\n");
  return text;
}

fs::path find_covers(const fs::path& root) {
  const fs::path libraries = root / ".venv" / "lib";
  if (!fs::is_directory(libraries)) return {};
  for (const fs::directory_entry& python : fs::directory_iterator(libraries)) {
    const fs::path meshes =
        python.path() / "site-packages/gym_hil/assets/franka_emika_panda/meshes";
    if (fs::is_directory(meshes)) return meshes;
  }
  return {};
}

}  // namespace tandem
