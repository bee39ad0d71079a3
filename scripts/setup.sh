# Set-up steps of ./tandem; sourced by it in the root of the tree. Each step is skipped when the hash of its inputs is the
# one that stands in .setup/STEP.stamp, so that a call with nothing to do costs a fraction of a second. Messages go to
# stderr: stdout belongs to the command. Logs of the steps: .setup/STEP.log.

setup_dir=.setup
extras_needed=no  # gym-hil: `bench sim` requires it, the videos of `train` and `demo` only look better with it
ray_needed=no     # `table --ray`, `ablate --ray`, and their tests
rerun_needed=no   # `export rerun`, `bench export`, and their tests
lerobot_needed=no # LeRobot's own reader: tests alone
test_needed=no    # Debian packages of tests alone
peers_needed=no   # ONNX Runtime and OpenVINO, for `bench policy`
more_targets=()   # programs that one command alone needs

say() { printf 'tandem: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

# stamp_of FILE...: hash of the contents (and of this script, which holds the commands).
stamp_of() { cat scripts/setup.sh "$@" | sha256sum | cut -d' ' -f1; }
stamped() { [ -f "$setup_dir/$1.stamp" ] && [ "$(<"$setup_dir/$1.stamp")" = "$2" ]; }
write_stamp() { printf '%s\n' "$2" >"$setup_dir/$1.stamp"; }

# run_step NAME TEXT COMMAND...: runs it with its output in .setup/NAME.log; shows time and the last line on a terminal.
run_step() {
  local name=$1 text=$2 log="$setup_dir/$1.log" start=$SECONDS pid status=0 line
  shift 2
  "$@" >"$log" 2>&1 </dev/null 9>&- &
  pid=$!
  trap 'kill "$pid" 2>/dev/null; exit 130' INT TERM
  if [ -t 2 ]; then
    while kill -0 "$pid" 2>/dev/null; do
      line=$(tail -n 1 "$log" 2>/dev/null | tr -d '\r' | cut -c1-60)
      printf '\r\033[Ktandem: %s (%d s) %s' "$text" $((SECONDS - start)) "$line" >&2
      sleep 0.5
    done
    printf '\r\033[K' >&2
  else
    say "$text ..."
  fi
  wait "$pid" || status=$?
  trap - INT TERM
  [ "$status" -eq 0 ] && say "$text: done in $((SECONDS - start)) s."
  return "$status"
}

# Runs a command as root: directly, or by sudo.
as_root() {
  if [ "$(id -u)" -eq 0 ]; then
    "$@"
  elif command -v sudo >/dev/null 2>&1; then
    sudo "$@"
  else
    return 126
  fi
}

install_packages() {
  as_root apt-get update
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$@"
}

# setup_packages NAME FILE: the Debian packages that FILE lists.
setup_packages() {
  local name=$1 file=$2 stamp wanted missing=() package
  stamp=$(stamp_of "$file")
  stamped "$name" "$stamp" && return 0
  command -v dpkg-query >/dev/null 2>&1 ||
    die "dpkg-query is missing, so this is not Debian; Tandem is set up on Debian 12. Install the equivalents of $file and write '$stamp' to $setup_dir/$name.stamp."
  wanted=$(sed 's/#.*//' "$file")
  for package in $wanted; do
    [ "$(dpkg-query -W -f '${db:Status-Abbrev}' "$package" 2>/dev/null)" = "ii " ] || missing+=("$package")
  done
  if [ ${#missing[@]} -gt 0 ]; then
    local command="apt-get update && apt-get install -y --no-install-recommends ${missing[*]}"
    if [ "$(id -u)" -ne 0 ]; then
      command -v sudo >/dev/null 2>&1 ||
        die "${#missing[@]} Debian packages are missing, and installing them takes root and there is no sudo. As root: $command"
      say "${#missing[@]} Debian packages are missing; sudo may ask for your password."
      sudo -v || die "sudo was refused. As root: $command"
    fi
    run_step "$name" "Installing ${#missing[@]} Debian packages" install_packages "${missing[@]}" ||
      die "Debian packages did not install ($(tail -n 1 "$setup_dir/$name.log")). See $PWD/$setup_dir/$name.log; by hand, as root: $command"
  fi
  write_stamp "$name" "$stamp"
}

# Prints a Python 3.11 interpreter.
find_python() {
  local candidate
  for candidate in /usr/bin/python3.11 python3.11 python3; do
    if command -v "$candidate" >/dev/null 2>&1 &&
      [ "$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" = 3.11 ]; then
      command -v "$candidate"
      return 0
    fi
  done
  return 1
}

install_python() {
  .venv/bin/python -m pip install --disable-pip-version-check --no-input --no-deps -r "$1"
}

# install_lerobot FOLDER: a virtual environment that sees Debian's PyTorch.
install_lerobot() {
  /usr/bin/python3.11 -m venv --clear --system-site-packages "$1"
  "$1/bin/python" -m pip install --disable-pip-version-check --no-input --no-deps -r requirements-lerobot.txt
}

setup_venv() {
  local stamp python
  stamp=$(stamp_of requirements.txt)
  stamped venv "$stamp" && [ -x .venv/bin/python ] && return 0
  if [ -x .venv/bin/python ]; then
    [ "$(.venv/bin/python -c 'import sys; print("%d.%d" % sys.version_info[:2])')" = 3.11 ] ||
      die "$PWD/.venv holds $(.venv/bin/python --version), Tandem is pinned to Python 3.11. Move .venv away and call again."
  fi
  if ! [ -x .venv/bin/python ] || ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    python=$(find_python) || die "Python 3.11 is missing (looked for python3.11 and python3). On Debian 12, as root: apt-get install python3 python3-venv"
    run_step venv "Creating .venv" "$python" -m venv .venv ||
      die ".venv could not be created by $python. See $PWD/$setup_dir/venv.log; on Debian, as root: apt-get install python3-venv"
  fi
  run_step venv "Installing $(grep -c == requirements.txt) Python packages" install_python requirements.txt ||
    die "Python packages did not install ($(tail -n 1 "$setup_dir/venv.log")). See $PWD/$setup_dir/venv.log; check the network and call again."
  write_stamp venv "$stamp"
}

# install_more NAME FILE WHAT: packages that few commands want, on first need.
install_more() {
  local stamp
  stamp=$(stamp_of "$2" requirements.txt)
  stamped "$1" "$stamp" && return 0
  run_step "$1" "Installing $3 and what it needs" install_python "$2" || return 1
  write_stamp "$1" "$stamp"
}

# gym-hil: a failure stops `bench sim`, and only costs videos their meshes.
setup_extras() {
  install_more extras requirements-extras.txt gym-hil && return 0
  [ "$extras_needed" != required ] ||
    die "gym-hil did not install ($(tail -n 1 "$setup_dir/extras.log")). See $PWD/$setup_dir/extras.log; check the network and call again."
  say "gym-hil did not install (see $PWD/$setup_dir/extras.log); the arm is drawn without its meshes."
}

setup_ray() {
  install_more ray requirements-ray.txt Ray ||
    die "Ray did not install ($(tail -n 1 "$setup_dir/ray.log")). See $PWD/$setup_dir/ray.log; check the network and call again."
}

setup_rerun() {
  install_more rerun requirements-rerun.txt Rerun ||
    die "Rerun did not install ($(tail -n 1 "$setup_dir/rerun.log")). See $PWD/$setup_dir/rerun.log; check the network and call again."
}

setup_lerobot() {
  local stamp
  stamp=$(stamp_of requirements-lerobot.txt scripts/debian-packages-test.txt)
  stamped lerobot "$stamp" && return 0
  run_step lerobot "Installing LeRobot's dataset reader" install_lerobot "$setup_dir/lerobot" ||
    die "LeRobot's dataset reader did not install ($(tail -n 1 "$setup_dir/lerobot.log")). See $PWD/$setup_dir/lerobot.log; check the network and call again."
  write_stamp lerobot "$stamp"
}

setup_peers() {
  install_more peers requirements-bench.txt "ONNX Runtime, OpenVINO" ||
    die "ONNX Runtime and OpenVINO did not install ($(tail -n 1 "$setup_dir/peers.log")). See $PWD/$setup_dir/peers.log; check the network and call again."
}

configure() {
  cmake -S . -B build -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER_LAUNCHER=ccache -DCMAKE_C_COMPILER_LAUNCHER=ccache
}

# Ninja itself is the quick check: with nothing to do it returns in a fraction of a second and prints one line. Programs
# only, where the tree has such a target; `./tandem test` builds the rest.
build_programs() {
  local log=$setup_dir/build.log start=$SECONDS target=() line shown=no
  grep -q '^build programs:' build/build.ninja && target=(programs lcm_types_python)
  [ ${#target[@]} -eq 0 ] || target+=("${more_targets[@]}")
  : >"$log"
  # 9>&- keeps the lock from processes that outlive this call.
  NINJA_STATUS='[%f/%t] ' ninja -C build "${target[@]}" 2>&1 </dev/null 9>&- | while IFS= read -r line; do
    printf '%s\n' "$line" >>"$log"
    [[ $line == \[* && $line != *"Re-checking globbed"* ]] || continue
    if [ -t 2 ]; then
      printf '\r\033[Ktandem: Building the C++ programs %s (%d s)' "${line%%]*}]" $((SECONDS - start)) >&2
    elif [ "$shown" = no ]; then
      say "Building the C++ programs ..."
    fi
    shown=yes
  done
  local status=${PIPESTATUS[0]}
  if grep '^\[' "$log" | grep -qv 'Re-checking globbed'; then
    [ -t 2 ] && printf '\r\033[K' >&2
    [ "$status" -eq 0 ] && say "Building the C++ programs: done in $((SECONDS - start)) s."
  fi
  return "$status"
}

setup_build() {
  local stamp
  stamp=$(stamp_of requirements.txt scripts/debian-packages.txt)
  if ! stamped configure "$stamp" || ! [ -f build/build.ninja ]; then
    run_step configure "Configuring the build" configure ||
      die "CMake could not configure the build. See $PWD/$setup_dir/configure.log for the missing part; then call again."
    write_stamp configure "$stamp"
  fi
  build_programs ||
    die "the build failed: $(grep -m 1 -E 'error:|undefined reference' "$setup_dir/build.log" || tail -n 1 "$setup_dir/build.log"). See $PWD/$setup_dir/build.log."
}

# LCM's multicast group goes through the loopback interface: no network card, no other machine. Needed after each boot.
setup_loopback() {
  local group=239.255.76.67
  command -v ip >/dev/null 2>&1 || return 0
  if ip link show lo | grep -q MULTICAST && ip route get "$group" 2>/dev/null | grep -q 'dev lo'; then
    return 0
  fi
  if [ "$(id -u)" -eq 0 ] && ip link set lo multicast on 2>/dev/null && ip route replace "$group/32" dev lo 2>/dev/null; then
    return 0
  fi
  # Without the right to change it, a route through another interface still carries messages between our programs.
  ip route get "$group" >/dev/null 2>&1 ||
    say "there is no route for LCM's multicast group $group, so the programs can't talk. As root: ip link set lo multicast on && ip route replace $group/32 dev lo"
}

setup_all() {
  case "${1:-} ${2:-}" in
    "bench sim") extras_needed=required ;;
    "bench policy") peers_needed=yes more_targets=(policy_contenders) ;;
    "bench learner") test_needed=yes more_targets=(tandem_machine_limits) ;;
    "test "*) test_needed=yes ray_needed=yes rerun_needed=yes lerobot_needed=yes ;;
    "export rerun" | "bench export") rerun_needed=yes ;;
    "train "* | "demo "*) extras_needed=wanted ;;
  esac
  for word in "$@"; do
    case "$word" in
      --ray | --ray=*) ray_needed=yes ;;
      --help | -h) extras_needed=no test_needed=no ray_needed=no rerun_needed=no lerobot_needed=no peers_needed=no more_targets=(); break ;;
    esac
  done

  mkdir -p "$setup_dir"
  command -v flock >/dev/null 2>&1 || die "flock is missing; as root: apt-get install util-linux"
  exec 9>"$setup_dir/lock"
  if ! flock -n 9; then
    say "another call is setting up; waiting for it."
    flock 9
  fi
  setup_packages packages scripts/debian-packages.txt
  [ "$test_needed" = no ] || setup_packages packages-test scripts/debian-packages-test.txt
  setup_venv
  [ "$extras_needed" = no ] || setup_extras
  [ "$ray_needed" = no ] || setup_ray
  [ "$rerun_needed" = no ] || setup_rerun
  [ "$lerobot_needed" = no ] || setup_lerobot
  [ "$peers_needed" = no ] || setup_peers
  setup_build
  setup_loopback
  exec 9>&-
}
