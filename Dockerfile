# The program with Debian's dolfinx:
#   docker build -t mic-contact . && docker run -v "$PWD/results:/srv/project/results" mic-contact
FROM debian:trixie-slim
COPY . /srv/project
WORKDIR /srv/project
RUN script/bootstrap && rm -rf /var/lib/apt/lists/*
ENTRYPOINT [".venv/bin/mic"]
CMD ["run", "meshes/wheelhouse"]
