"""Build a minimal tf2_msgs (TFMessage only) into the virtual environment that runs this script.

    VENV/bin/python build_tf2_msgs.py

The environment holds the ROS 2 wheels (rclpy, geometry_msgs, rmw_fastrtps_cpp, and the rosidl
generators that come with them).  The real generators write the sources; one extension module,
tf2_msgs/tf2_msgs_s__rosidl_typesupport_c.so, holds everything that rclpy asks for: the message's
functions, its type description and hash, the conversions from and to Python objects, and the
type supports fastrtps_c (rmw_fastrtps_cpp marshals with it) and introspection_c (rmw_fastrtps_cpp
of Jazzy describes the type to Fast DDS with it).
Needs gcc and g++; takes one core for a few seconds.
"""

import importlib
import json
import pathlib
import shutil
import subprocess
import sys
import sysconfig
import tempfile

import numpy
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_generator_c import generate_c
from rosidl_generator_py.generate_py_impl import generate_py
from rosidl_generator_type_description import generate_type_hash
from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
from rosidl_typesupport_introspection_c import generate_c as generate_typesupport_introspection_c

PACKAGE = "tf2_msgs"
DEPENDENCY = "geometry_msgs"
PREFIX = pathlib.Path(sys.prefix)
SITE = pathlib.Path(sysconfig.get_paths()["platlib"])


def generate(work):
    """The generators' output: C headers and sources under work/include, Python under work/py."""
    (work / "msg").mkdir()
    (work / "msg" / "TFMessage.msg").write_text("geometry_msgs/TransformStamped[] transforms\n")
    convert_msg_to_idl(work, PACKAGE, pathlib.Path("msg/TFMessage.msg"), work / "msg")
    include = work / "include" / PACKAGE

    def arguments(generator, output):
        """The file of arguments that CMake would have written for this generator."""
        path = work / f"{generator}.json"
        path.write_text(
            json.dumps(
                {
                    "package_name": PACKAGE,
                    "output_dir": str(output),
                    "template_dir": str(PREFIX / "share" / generator / "resource"),
                    "idl_tuples": [f"{work}:msg/TFMessage.idl"],
                    "ros_interface_files": [str(work / "msg" / "TFMessage.msg")],
                    "include_paths": [f"{DEPENDENCY}:{PREFIX / 'share' / DEPENDENCY}"],
                    "type_description_tuples": [f"msg/TFMessage.idl:{work / 'json/msg/TFMessage.json'}"],
                    "target_dependencies": [],
                }
            )
        )
        return str(path)

    generate_type_hash(arguments("rosidl_generator_type_description", work / "json"))
    generate_c(arguments("rosidl_generator_c", include))
    generate_typesupport_fastrtps_c(arguments("rosidl_typesupport_fastrtps_c", include))
    generate_typesupport_introspection_c(arguments("rosidl_typesupport_introspection_c", include))
    (work / "py" / "msg").mkdir(parents=True)
    (work / "py" / "__init__.py").write_text("")
    generate_py(arguments("rosidl_generator_py", work / "py"), ["rosidl_typesupport_c"])
    # CMake's configure_file makes these from templates beside the generators' own.
    for generator in ("rosidl_generator_c", "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"):
        name = f"{generator}__visibility_control.h"
        text = (PREFIX / "share" / generator / "resource" / f"{name}.in").read_text()
        text = text.replace("@PROJECT_NAME_UPPER@", PACKAGE.upper()).replace("@PROJECT_NAME@", PACKAGE)
        (include / "msg" / name).write_text(text)
    # In place of what the generator rosidl_typesupport_c writes, which would look for the type
    # supports in libraries of their own.
    (work / "dispatch.c").write_text("""
#include <string.h>
#include "rosidl_runtime_c/message_type_support_struct.h"
#include "rosidl_typesupport_interface/macros.h"

#define SYMBOL(support) \\
  ROSIDL_TYPESUPPORT_INTERFACE__MESSAGE_SYMBOL_NAME(support, tf2_msgs, msg, TFMessage)
typedef rosidl_message_type_support_t support_t;

const support_t * SYMBOL(rosidl_typesupport_fastrtps_c)(void);
const support_t * SYMBOL(rosidl_typesupport_introspection_c)(void);

static const support_t * choose(const support_t * handle, const char * identifier)
{
  (void)handle;
  const support_t * fast = SYMBOL(rosidl_typesupport_fastrtps_c)();
  const support_t * introspection = SYMBOL(rosidl_typesupport_introspection_c)();
  if (0 == strcmp(identifier, fast->typesupport_identifier)) {return fast;}
  if (0 == strcmp(identifier, introspection->typesupport_identifier)) {return introspection;}
  return NULL;
}

const support_t * SYMBOL(rosidl_typesupport_c)(void)
{
  static support_t handle;
  handle = *SYMBOL(rosidl_typesupport_fastrtps_c)();
  handle.typesupport_identifier = "rosidl_typesupport_c";
  handle.data = NULL;
  handle.func = choose;
  return &handle;
}
""")


def build(work):
    """Compile and link the one extension module, into work/py."""
    detail = work / "include" / PACKAGE / "msg" / "detail"
    sources = [
        detail / "tf_message__functions.c",
        detail / "tf_message__description.c",
        detail / "tf_message__type_support_c.cpp",  # fastrtps_c
        detail / "tf_message__type_support.c",  # introspection_c
        work / "py" / "msg" / "_tf_message_s.c",
        work / "py" / f"_{PACKAGE}_s.ep.rosidl_typesupport_c.c",
        work / "dispatch.c",
    ]
    # An installed header is included as <package/...>: include/package/package/... or, for the
    # few packages that do not repeat their name, include/package/...
    includes = [work / "include", PREFIX / "include"]
    includes += sorted(path for path in (PREFIX / "include").iterdir() if path.is_dir())
    includes += [sysconfig.get_paths()["include"], numpy.get_include()]
    flags = ["-O1", "-fPIC", "-w", *(f"-I{path}" for path in includes)]
    objects = []
    for source in sources:
        objects.append(work / f"{source.name}.o")
        compiler = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc", "-std=gnu11"]
        subprocess.run([*compiler, *flags, "-c", source, "-o", objects[-1]], check=True)
    libraries = [
        *(
            f"-l{DEPENDENCY}__{part}"
            for part in (
                "rosidl_generator_c",
                "rosidl_generator_py",
                "rosidl_typesupport_fastrtps_c",
                "rosidl_typesupport_introspection_c",
            )
        ),
        "-lstd_msgs__rosidl_generator_c",
        "-lbuiltin_interfaces__rosidl_generator_c",
        "-lrosidl_runtime_c",
        "-lrosidl_typesupport_fastrtps_c",
        "-lrosidl_typesupport_fastrtps_cpp",
        "-lrosidl_typesupport_introspection_c",
        "-lfastcdr",
        "-lrcutils",
    ]
    module = work / "py" / f"{PACKAGE}_s__rosidl_typesupport_c.so"
    # Python's own symbols, and what the wheels' libraries need of one another, are found at run
    # time, so undefined symbols are no error here: main imports the module, which is the check.
    subprocess.run(
        ["g++", "-shared", "-o", module, *objects, f"-L{PREFIX / 'lib'}", *libraries, "-Wl,--allow-shlib-undefined"],
        check=True,
    )


def main():
    with tempfile.TemporaryDirectory() as folder:
        work = pathlib.Path(folder)
        generate(work)
        build(work)
        for source in (work / "py").rglob("*.c"):
            source.unlink()
        shutil.rmtree(SITE / PACKAGE, ignore_errors=True)
        shutil.copytree(work / "py", SITE / PACKAGE)
    # The module is loaded with RTLD_NOW: a missing symbol fails here.
    importlib.invalidate_caches()
    module = importlib.import_module(f"{PACKAGE}.{PACKAGE}_s__rosidl_typesupport_c")
    print("installed", module.__file__)


if __name__ == "__main__":
    main()
