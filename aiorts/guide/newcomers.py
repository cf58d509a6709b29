"""The words that a newcomer types, and the page that answers each: including words that the page does not use.

A word for what aiorts does not have leads to the page that says so.
"""

from __future__ import annotations

from typing import Final

ASKED: Final[dict[str, tuple[str, ...]]] = {
    "component": ("quickstart", "getting started", "hello world", "first steps", "beginner", "install", "introduction"),
    "ports": ("pubsub", "publisher", "subscriber", "message passing"),
    "parameters": ("settings", "options of a component", "config", "configuration"),
    "testing": ("unit test", "unittest", "pytest", "mock", "virtual time", "fast forward"),
    "system": ("launch file", "toml", "system file", "wiring"),
    "recording": ("replay", "play back", "playback", "csv", "plot", "log file of samples", "salvage"),
    "plugin": ("package", "pip", "publish", "distribute my code"),
    "fastapi": ("websocket", "websockets", "health", "healthcheck", "http", "rest", "web", "web app", "embed", "flask"),
    "look-into": ("visualize", "inspect a running system", "cli", "command line tools", "monitor"),
    "run-system": ("run", "exit code", "ctrl-c", "stdin", "autoreload", "hot reload"),
    "choose-policy": ("queue size", "buffer size", "newest", "backpressure", "drop old"),
    "quality-of-service": (
        "stands still",
        "stand still",
        "feedback loop",
        "nothing happens",
        "no data",
        "deadlock",
        "components feed each other",
    ),
    "slow-reader": (
        "slow reader",
        "losses",
        "lost",
        "lost samples",
        "dropped",
        "drops",
        "slow consumer",
        "where are my samples",
        "how old is the data",
        "stale data",
    ),
    "records": ("custom message", "message type", "dataclass", "pydantic", "schema of messages", "own type"),
    "camera": ("image", "images", "video", "opencv", "numpy array"),
    "real-time": ("rt", "preempt_rt", "jitter", "cpu affinity", "priority"),
    "supervise": ("restart", "retry", "crash loop", "recover"),
    "deploy": ("docker", "container", "systemd", "daemon", "production", "raspberry", "raspberry pi", "offline"),
    "ros-bag": ("rosbag", "bag", "rosbag2"),
    "missed-deadline": ("deadline", "profiler", "slow callback", "blocked loop"),
    "services": ("rpc", "request", "request response", "client server"),
    "goals": ("action", "action server", "long running", "feedback"),
    "state-machines": ("fsm", "statechart", "behavior"),
    "connect-processes": ("ipc", "shared memory", "two programs"),
    "connect-hosts": ("two machines", "tcp", "zenoh", "discovery", "several hosts"),
    "secure-network": ("tls", "encryption", "authentication", "certificates", "password", "access control"),
    "run-fleet": ("fleet", "many robots"),
    "isolate-components": ("crash", "segfault", "gil", "own process"),
    "one-file": ("gazebo", "mujoco", "simulator", "simulation", "digital twin"),
    "observe": ("events", "callback", "notifications"),
    "measure-live": ("latency", "throughput", "frequency"),
    "live-log": ("logging", "loguru", "debug output", "log level"),
    "foxglove-live": ("rviz", "rviz2", "3d", "plotjuggler", "rerun", "viewer", "gui for data", "visualization"),
    "watch-in-the-browser": ("gui", "dashboard", "browser", "rtsystemeditor", "rtclink", "rqt", "node-red", "web page"),
    "use-the-http-api": ("openapi", "swagger", "javascript", "curl", "rest api", "http api", "rosbridge"),
    "notebook": ("jupyter", "ipython"),
    "measured": ("performance", "how fast", "benchmark", "overhead", "memory", "cpu usage"),
    "limits": (
        *("metrics", "prometheus", "grafana", "influxdb", "opentelemetry", "kubernetes", "k8s"),
        *("windows", "macos", "mqtt", "grpc", "protobuf", "dds", "database", "gpu", "cuda", "microcontroller"),
        *("esp32", "arduino", "tf", "tf2", "urdf", "behavior tree", "hard real time", "drivers", "rust", "qt"),
    ),
    "stability": ("deprecated", "deprecation", "stable", "breaking changes", "semver", "experimental", "provisional"),
    "releases": ("version", "license", "licence", "changelog", "air gapped"),
    "ros2": ("ros", "ros2", "ros 2", "rclpy", "nav2"),
    "openrtm": ("openrtm", "rtc", "rtm", "corba"),
}
"""Page -> words and phrases; a phrase counts where all of its words are in the question."""
