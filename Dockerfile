# docker build -t structid .
# docker run --rm -v "$PWD:/work" structid identify study.toml
# docker run --rm --network host -v "$PWD:/work" structid app --port 8765 --no-browser
FROM python:3.12-slim AS build
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir build && python -m build --wheel --outdir /wheels .

FROM python:3.12-slim
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir "$(ls /wheels/structid-*.whl)[app,fast]" && rm -r /wheels \
    && useradd --create-home engineer
USER engineer
WORKDIR /work
ENTRYPOINT ["structid"]
CMD ["--help"]
