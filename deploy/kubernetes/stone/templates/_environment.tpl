{{/* Render a number as an integer if possible: Helm parses all numbers as floats and would write 4.294967296e+10. */}}
{{- define "stone.plain" -}}
{{- if and (kindIs "float64" .) (eq (floor .) .) }}{{ int64 . }}{{ else }}{{ . }}{{ end }}
{{- end }}

{{/* Settings are in the pod, not in a ConfigMap: a changed setting restarts the pods, and a rollback reverts it. */}}
{{- define "stone.environment" -}}
{{- if and .root.Values.ingress.enabled (not .root.Values.settings.api.trusted_proxies) }}
{{- fail "settings.api.trusted_proxies is empty: list the addresses of the ingress controller's pods (CIDR); otherwise all users share one rate limit" }}
{{- end }}
- name: STONE_DATA_FOLDER
  value: /data
{{- range $group, $names := .root.Values.settings }}
{{- range $name, $value := $names }}
- name: {{ printf "STONE_%s__%s" (upper $group) (upper $name) }}
  value: {{ include "stone.plain" $value | quote }}
{{- end }}
{{- end }}
{{- if .root.Values.redis.enabled }}
- name: STONE_BROKER__URL
  value: {{ printf "redis://%s:6379/0" (include "stone.name" (dict "root" .root "role" "redis")) }}
{{- end }}
{{- with .processes }}
- name: STONE_WORKERS
  value: {{ . | quote }}
- name: STONE_JOBS__DRAIN_S
  value: {{ $.root.Values.workers.drain_s | quote }}
{{- end }}
{{- range $name, $value := .root.Values.environment }}
- name: {{ $name }}
  value: {{ include "stone.plain" $value | quote }}
{{- end }}
{{- end }}

{{/* The secrets of a role, as files; the keys of the Secret are the names of the files. */}}
{{- define "stone.secrets" -}}
{{- $names := list "stone_database__password" -}}
{{- $names = concat $names (list "stone_store__s3_key_id" "stone_store__s3_secret") -}}
{{- if not (has .role (list "prepare" "backup")) }}{{ $names = append $names "stone_broker__password" }}{{ end -}}
{{- if eq .role "api" }}{{ $names = append $names "stone_api__metrics_token" }}{{ end -}}
{{- if eq .role "prepare" }}{{ $names = append $names "stone_api__first_password" }}{{ end -}}
secretName: {{ .root.Values.secrets.existing }}
defaultMode: 288 # 0440
items:
{{- range $names }}
  - { key: {{ . }}, path: {{ . }} }
{{- end }}
{{- end }}
