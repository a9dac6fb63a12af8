#!/usr/bin/env bash
# The README followed on a machine that has nothing but Python and make: a Debian of its own in a folder.
#
#   benchmarks/bare_machine.sh FOLDER [system|demo]
#
# As root, with debootstrap. In FOLDER (made on the first call) a visitor without rights and then root follow the
# README in an empty clone of this repository: the visitor must be told one line before any download, root must
# get the libraries installed ("system") and, by default, a plan ("demo": some 2.2 GB, some minutes).
set -euo pipefail
root=$(realpath -m "$1"); goal=${2:-demo}
here=$(git -C "$(dirname "$0")" rev-parse --show-toplevel)
if [ ! -x "$root/usr/bin/python3" ]; then
  debootstrap --variant=minbase --include=python3,python3-venv,make,git,ca-certificates stable "$root"
fi
inside() {  # inside USER COMMANDS: in the folder as its root, in a mount namespace of its own
  unshare -m bash -c '
    mount --make-rprivate / && mount -t proc proc "$0/proc" && mount --rbind /dev "$0/dev"
    home=$([ "$1" = root ] && echo /root || echo "/home/$1")
    exec chroot --userspec="$1:$1" "$0" /usr/bin/env -i HOME="$home" LANG=C.UTF-8 \
      PATH=/usr/sbin:/usr/bin:/sbin:/bin bash -c "$2"' "$root" "$1" "$2"
}
cp /etc/resolv.conf /etc/hosts "$root/etc/"
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
[ ! -f /etc/pip.conf ] || cp /etc/pip.conf "$root/etc/"
rm -rf "$root/srv/scanmotion.git" && git clone -q --bare "$here" "$root/srv/scanmotion.git"
libraries=$(sed -n 's/^    "lib.*": "\(.*\)",$/\1/p' "$here/models/check_system.py" | tr '\n' ' ')
inside root "id visitor >/dev/null 2>&1 || useradd -m visitor
  apt-get purge -y -qq $libraries >/dev/null 2>&1; apt-get autoremove -y -qq >/dev/null 2>&1
  git config --system --add safe.directory '*'; rm -rf /root/scanmotion /home/visitor/scanmotion"
clone="cd && git clone -q /srv/scanmotion.git && cd scanmotion"
echo "== a visitor: make demo"
if inside visitor "$clone && make demo"; then echo "it went on without its libraries"; exit 1; fi
if [ -e "$root/home/visitor/scanmotion/.venv" ]; then echo "it downloaded before it looked"; exit 1; fi
echo "== root: make $goal"
inside root "$clone && make $goal"
